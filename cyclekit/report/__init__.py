"""The report: one page that an integrator hands to the customer, or the same as data.

    facts = compose_report(dataset, model, Path("report.html"), estimates=estimates, evaluation=evaluation)
    write_pdf(facts.path, Path("report.pdf"))

In: a dataset, and a model, estimates and their validation if there are any. Out: a page (`page`), or its content as
data. The page names what is missing; that is not an error. A figure is one module in `figures`. Used by `api`, `fleet`.
`estimate` takes its sentences from here, without the page: what makes the page is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.report.page import FORMATS as FORMATS
    from cyclekit.report.page import ReportFacts as ReportFacts
    from cyclekit.report.page import compose_report as compose_report
    from cyclekit.report.pdf import need_browser as need_browser
    from cyclekit.report.pdf import write_pdf as write_pdf
    from cyclekit.report.template import Template as Template
    from cyclekit.report.tried import Tried as Tried
    from cyclekit.report.tried import load_tried as load_tried

_HOMES = {
    "FORMATS": "page",
    "ReportFacts": "page",
    "compose_report": "page",
    "need_browser": "pdf",
    "write_pdf": "pdf",
    "Template": "template",
    "Tried": "tried",
    "load_tried": "tried",
}

if not TYPE_CHECKING:  # type checkers use the imports above, which finds misspelt names

    def __getattr__(name: str) -> object:
        """Import a name when it is first used."""
        if name not in _HOMES:
            msg = f"module 'cyclekit.report' has no attribute {name!r}"
            raise AttributeError(msg)
        return getattr(import_module(f"cyclekit.report.{_HOMES[name]}"), name)

"""The report: one page that an integrator hands to the customer, or the same as data.

    facts = compose_report(dataset, model, Path("report.html"), estimates=estimates, evaluation=evaluation)
    write_pdf(facts.path, Path("report.pdf"))

The page names what is missing; that is not an error. Besides `plots`, only this package imports matplotlib; only it
imports jinja2.
"""

from __future__ import annotations

from cyclekit.report.page import FORMATS, ReportFacts, compose_report
from cyclekit.report.pdf import need_browser, write_pdf
from cyclekit.report.template import Template
from cyclekit.report.tried import Tried, load_tried

__all__ = ["FORMATS", "ReportFacts", "Template", "Tried", "compose_report", "load_tried", "need_browser", "write_pdf"]

from __future__ import annotations

import browser
import pytest
from fabricated import fabricate_dataset
from report_pages import DistanceModel, Judgement, Page, estimate

from cyclekit.report import compose_report


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=4, rounds=1)


@pytest.fixture(scope="session")
def written(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "report.html"
    ranked = [estimate("B first", 33.0), estimate("A first", 30.0), estimate("C first", 30.8, limits=("Thin logs.",))]
    return compose_report(dataset, DistanceModel(), out, estimates=ranked, evaluation=Judgement(), cell_name="Cell 7")


@pytest.fixture(scope="session")
def page(written):
    return Page(written.path.read_text("utf-8"))


@pytest.fixture(scope="module")
def tab():
    """A tab of the installed browser."""
    with browser.open_browser() as tab:
        yield tab

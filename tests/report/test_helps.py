from __future__ import annotations

import json

import pytest
from report_pages import Page, estimate

from cyclekit.errors import CyclekitError
from cyclekit.report import load_what_if, write_report


def test_what_was_tried_is_held_against_todays_estimate(dataset, tmp_path):
    file = tmp_path / "changed.json"
    file.write_text(json.dumps({"sequences": [estimate("A first", 27.0).to_json()]}), "utf-8")
    changes = load_what_if("table 0.3 m back", file)
    facts = write_report(dataset, None, tmp_path / "r.html", estimates=[estimate("A first", 30.0)], what_if=changes)
    text = Page(facts.path.read_text("utf-8")).text
    assert "table 0.3 m back A first 27.0 26.4 to 27.6 3.0" in text
    assert "No change of zones, layout or speeds was estimated" not in text


@pytest.mark.parametrize("content", ["", "{}", '{"sequences": [{"name": "A"}]}', '{"sequences": 3}', "[1]"])
def test_a_file_that_holds_no_estimates_is_refused_with_the_cure(tmp_path, content):
    file = tmp_path / "changed.json"
    file.write_text(content, "utf-8")
    with pytest.raises(CyclekitError, match=r"changed\.json") as caught:
        load_what_if("x", file)
    assert "cyclekit estimate" in str(caught.value)

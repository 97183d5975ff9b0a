from __future__ import annotations

import pytest
from report_pages import Page

from cyclekit.errors import CyclekitError
from cyclekit.report import compose_report

pytestmark = pytest.mark.usefixtures("words_only")


@pytest.fixture
def house(tmp_path):
    folder = tmp_path / "house"
    folder.mkdir()
    (folder / "logo.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>", "utf-8")
    (folder / "cover.html.jinja").write_text("<section><p>For {{ cell }} only</p></section>", "utf-8")
    (folder / "texts.toml").write_text('language = "it"\n[answer]\ntitle = "La risposta"\n', "utf-8")
    (folder / "extra.css").write_text("h1 { color: #123456; }", "utf-8")
    return folder


def test_an_integrators_folder_changes_logo_cover_language_and_style(dataset, house, tmp_path):
    facts = compose_report(dataset, None, tmp_path / "r.html", template=house, cell_name="Cell 7")
    text = facts.path.read_text("utf-8")
    page = Page(text)
    assert page.faults == []
    assert page.all("html")[0]["lang"] == "it"
    assert "La risposta" in page.text
    assert "Where the time goes" in page.text
    assert "For Cell 7 only" in page.text
    assert page.all("img")[0]["src"].startswith("data:image/svg+xml;base64,")
    assert "#123456" in text


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("texts.toml", '[answer]\ntitel = "x"\n', "there is no text answer.titel"),
        ("texts.toml", '[answer]\nbest = "{nmae}"\n', "answer.best has no value nmae"),
        ("texts.toml", "[answer", "texts.toml cannot be used"),
        ("page.html.jinja", "{{ nothing }}", "the template cannot be rendered"),
        ("page.html.jinja", "{{ ''.__class__.__mro__ }}", "the template cannot be rendered"),
        ("page.html.jinja", "{{ 1 // 0 }}", "the template cannot be rendered"),
        ("page.html.jinja", "{{ range(10 ** 9) | list }}", "the template cannot be rendered"),
        ("page.html.jinja", "{% include '../secret.txt' %}", "leads out of the folder"),
    ],
)
def test_a_template_that_is_wrong_is_named_and_nothing_is_written(dataset, house, tmp_path, name, content, said):
    (house / name).write_text(content, "utf-8")
    with pytest.raises(CyclekitError, match=said):
        compose_report(dataset, None, tmp_path / "out" / "r.html", template=house)
    assert not (tmp_path / "out" / "r.html").exists()


def test_a_folder_without_a_template_is_refused(dataset, tmp_path):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(CyclekitError, match="Put one or more of these files there"):
            compose_report(dataset, None, tmp_path / "r.html", template=folder)

"""The page in a real Chromium: what it asks for, says, shows, filters and prints, and whether it shuts anybody out."""

from __future__ import annotations

import dataclasses
import json
import re
import zlib
from importlib.resources import files

import browser
import numpy as np
import pytest
from fabricated import THRESHOLDS_M, fabricate_dataset
from report_pages import cycles_of

from cyclekit.dataset.cards import TrainingCard
from cyclekit.errors import CyclekitError
from cyclekit.estimate.result import CycleEstimate, TaskShare
from cyclekit.report import Tried, compose_report, pdf, write_pdf

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not())),
]


class Model:
    problem, network = "now", "classifier"

    def __init__(self):
        self.card = TrainingCard(cyclekit="0.1.0")

    def predict(self, x):
        distance = np.linalg.norm(x[:, :3] - x[:, 3:], axis=1)
        return np.searchsorted(np.array(THRESHOLDS_M), distance) / 4


class Judgement:
    def __init__(self, executions):
        self.executions = executions

    def to_dict(self):
        confusion = (np.eye(5) * 90 + 2).astype(int).tolist()
        levels = [{"level": level / 4} for level in range(5)]
        rows = [{"name": "model", "mse": 3e-4, "note": ""}, {"name": "constant mean", "mse": 0.1, "note": "x"}]
        return {"mse": rows, "accuracy": 0.98, "confusion": confusion, "levels": levels, "executions": self.executions}


def estimates():
    names = [f"conveyor->slot_{n}" for n in range(24)]
    tasks = tuple(TaskShare(name, 4.0 + 0.02 * n, 1.5, 1.5 + 0.02 * n, 1.0, 0.0) for n, name in enumerate(names))
    one = CycleEstimate(
        name="A first", places=("conveyor",), expected_s=96.0, expected_low_s=95.0, expected_high_s=97.0,
        distribution=cycles_of({0.05: 90.0, 0.5: 96.0, 0.95: 103.0}),
        nominal_s=36.0, safety_loss_s=36.0, dwell_s=24.0, wait_s=0.0,
        support=0.97, tracks=40, limits=(), tasks=tasks, safety_by_activity_s={"shelf": 20.0, "desk": 16.0},
        durations_s=tuple(float(v) for v in range(86, 106)),
    )  # fmt: skip
    return [
        one,
        dataclasses.replace(one, name="B first", expected_s=104.0, expected_low_s=103.0, expected_high_s=105.0),
    ]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    dataset = fabricate_dataset(folder / "dataset", executions=4, rounds=1)
    names = dataset.executions["execution"].to_list()
    changed = [Tried("conveyor 0.3 m back", "A first", 90.0, 89.0, 91.0)]
    facts = compose_report(
        dataset, Model(), folder / "report.html", estimates=estimates(), evaluation=Judgement(names), takt_s=100.0,
        what_if=changed, cell_name="Cell 7",
    )  # fmt: skip
    return facts.path


@pytest.fixture
def desk(tab, page):
    tab.events.clear()
    tab.show(page)
    return tab


def test_the_page_says_no_error_and_asks_for_nothing_but_itself(desk, page):
    assert desk.said() == []
    assert set(desk.requests()) == {page.resolve().as_uri()}
    wanted = desk.ask("performance.getEntriesByType('resource').length")
    assert wanted == 0


def test_a_script_that_is_not_the_pages_own_is_not_run(tab, page, tmp_path):
    forged = tmp_path / "forged.html"
    forged.write_text(page.read_text("utf-8").replace("</main>", "<script>window.ran = 1</script></main>"), "utf-8")
    tab.show(forged)
    assert tab.ask("window.ran === undefined")
    assert tab.ask("document.querySelector('.tip-box') !== null")  # ours has run


def test_pointing_at_a_bar_says_its_numbers(desk):
    at = desk.ask(
        "(async () => {"
        " const bars = [...document.querySelectorAll('#where .wide g.tip')];"
        " const bar = bars.find(g => g.dataset.tip.includes('slot_3: slow-down'));"
        " bar.scrollIntoView({block: 'center'});"
        " await new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)));"
        " const b = bar.getBoundingClientRect();"
        " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
    )
    assert desk.ask("document.querySelector('.tip-box').hidden")
    desk.point_at(*at)
    assert not desk.ask("document.querySelector('.tip-box').hidden")
    assert "slow-down (mean speed 49 %) 1.6 s (38 % of the task)" in desk.ask(
        "document.querySelector('.tip-box').textContent"
    )
    desk.point_at(2, 2)
    assert desk.ask("document.querySelector('.tip-box').hidden")


@pytest.mark.parametrize("section", ["answer", "where", "why", "trust"])
def test_every_picture_says_numbers_under_the_pointer_also_without_a_script(page, section):
    text = page.read_text("utf-8")
    start = text.index(f'<section id="{section}">')
    part = text[start : text.index("</section>", start)]
    figures = part.split("<figure>")[1:]
    assert figures
    assert all(len(re.findall(r'<g class="tip"[^>]*><title>[^<]*\d', figure)) >= 2 for figure in figures)


def test_the_filter_shows_what_is_asked_for_and_gives_all_back(desk):
    rows = "[...document.querySelectorAll('#where tbody tr')].filter(row => !row.hidden).length"
    hidden = (
        "[...document.querySelectorAll('#where g.tip')].filter(g => getComputedStyle(g).visibility == 'hidden').length"
    )
    everything = desk.ask(rows)
    assert desk.ask(hidden) == 0
    desk.ask("document.querySelector('.filter input').focus()")
    desk.type("slot_7")
    assert desk.ask(rows) == 2  # one per sequence
    assert desk.ask(hidden) > 40
    assert desk.ask("document.querySelector('.filter output').textContent").startswith("2 / ")
    desk.ask("(() => { const f = document.querySelector('.filter input'); f.value = '';"
             " f.dispatchEvent(new Event('input')); })()")  # fmt: skip
    assert desk.ask(rows) == everything
    assert desk.ask(hidden) == 0


@pytest.mark.parametrize(("width", "phone"), [(360, True), (390, True), (768, False), (1400, False)])
def test_the_page_fits_its_window(tab, page, width, phone):
    tab.show(page, width=width, height=800, phone=phone)
    assert tab.ask("document.documentElement.scrollWidth") <= width
    seen = "[...document.querySelectorAll('figure svg')].filter(s => s.getBoundingClientRect().width > 0)"
    assert tab.ask(f"{seen}.length") == tab.ask("document.querySelectorAll('figure').length")
    assert tab.ask(f"{seen}.every(s => s.getBoundingClientRect().right <= innerWidth)")


def test_no_text_of_a_picture_is_cut_off(desk):
    cut = desk.ask(
        "[...document.querySelectorAll('figure svg')].filter(s => s.getBoundingClientRect().width > 0).flatMap(s => {"
        " const f = s.getBoundingClientRect(); return [...s.querySelectorAll('text')].filter(t => {"
        " const b = t.getBoundingClientRect(); return b.left < f.left - 2 || b.right > f.right + 2 || b.top < f.top - 2"
        " || b.bottom > f.bottom + 2; }).map(t => t.textContent); })"
    )
    assert cut == []


def test_on_a_phone_no_column_of_the_answer_is_cut_and_no_names_on_the_floor_cover_each_other(tab, page):
    tab.show(page, width=390, height=844, phone=True)
    table = "document.querySelector('#answer .scroll')"
    assert tab.ask(f"{table}.scrollWidth <= {table}.clientWidth")
    assert tab.ask(f"[...{table}.querySelectorAll('td')].every(d => d.getBoundingClientRect().right <= innerWidth)")
    first = f"{table}.querySelector('td')"
    assert tab.ask(f"getComputedStyle({first}, '::before').content + {first}.textContent") == '"Rank"1'
    common = tab.ask(
        "[...document.querySelectorAll('#why .narrow svg')].flatMap(svg => {"
        " const t = [...svg.querySelectorAll('text')].filter(t => t.textContent.trim());"
        " const b = t.map(t => t.getBoundingClientRect());"
        " return b.flatMap((a, i) => b.slice(i + 1).flatMap((c, k) =>"
        "  a.left < c.right && c.left < a.right && a.top < c.bottom - 2 && c.top < a.bottom - 2"
        "  ? [t[i].textContent + ' / ' + t[i + 1 + k].textContent] : [])); })"
    )
    assert common == []


def test_the_contents_lead_to_every_section(desk):
    links = desk.ask("[...document.querySelectorAll('.contents a')].map(a => [a.hash.slice(1), a.textContent])")
    assert [name for name, _ in links] == desk.ask("[...document.querySelectorAll('section')].map(s => s.id)")
    heads = desk.ask("[...document.querySelectorAll('h2')].map(h => h.textContent)")
    assert [text for _, text in links] == heads
    shown = desk.ask("['play', 'to-play'].map(id => document.getElementById(id)).map(e => e ? e.hidden : null)")
    assert shown in ([True, True], [False, False], [None, None])  # this model cannot be played


def test_printed_captions_are_as_large_as_the_text_and_maps_stand_side_by_side(tab, page):
    tab.show(page, width=680, height=1000)
    tab.call("Emulation.setEmulatedMedia", media="print")
    size = "parseFloat(getComputedStyle(document.querySelector('{}')).fontSize)"
    text = tab.ask(size.format("p.lead"))
    for each in ("figcaption", "caption", ".note"):
        assert tab.ask(size.format(each)) == text
    assert tab.ask(size.format("td")) < text
    tops = tab.ask("[...document.querySelectorAll('#why .half')].map(e => Math.round(e.getBoundingClientRect().top))")
    assert len(tops) == 2
    assert len(set(tops)) == 1
    rules = tab.ask("[...document.styleSheets[0].cssRules].find(r => r instanceof CSSPageRule).cssText")
    assert "counter(page)" in rules
    tab.call("Emulation.setEmulatedMedia", media="")


def pages_of(printed):
    return len(re.findall(rb"/Type\s*/Page\b", printed))


def test_printed_every_chart_lies_whole_on_one_page(tab, page):
    tab.show(page, width=680, height=1000)  # the width of the text on A4, so that what is measured is what is printed
    tab.call("Emulation.setEmulatedMedia", media="print")
    tall = tab.ask("[...document.querySelectorAll('figure')].map(f => f.getBoundingClientRect().height)")
    assert max(tall) < (297 - 34) / 25.4 * 96  # no chart is higher than a page's text
    inside = tab.ask("[...document.querySelectorAll('figure')].every(f => getComputedStyle(f).breakInside === 'avoid')")
    assert inside
    hidden = tab.ask("[...document.querySelectorAll('.filter, .chart:not(.half) .narrow, .half .wide, details')]"
                     ".every(e => getComputedStyle(e).display === 'none')")  # fmt: skip
    assert hidden
    tab.call("Emulation.setEmulatedMedia", media="")
    assert 5 <= pages_of(tab.pdf()) <= 14


def test_printed_sections_keep_away_from_the_foot_and_the_statement_does_not_drag_what_follows_along(tab, page):
    tab.show(page, width=680, height=1000)
    tab.call("Emulation.setEmulatedMedia", media="print")
    room = tab.ask("[...document.querySelectorAll('h2')].map(h => parseFloat(getComputedStyle(h, '::after').height))")
    assert min(room) > 40 / 25.4 * 96 - 1.0
    assert tab.ask("getComputedStyle(document.querySelector('.statement > p')).breakAfter") == "auto"
    tab.call("Emulation.setEmulatedMedia", media="")


def test_the_printed_contents_name_the_page_of_each_section(tab, page, tmp_path, monkeypatch):
    tab.show(page, width=680, height=1000)
    printed_pages, printing = [], pdf._print
    monkeypatch.setattr(pdf, "_print", lambda browser, file, folder: (
        printed_pages.append(file.read_text("utf-8")), printing(browser, file, folder))[1])  # fmt: skip
    write_pdf(page, tmp_path / "report.pdf")
    printed = (tmp_path / "report.pdf").read_bytes()
    found = pdf.pages_of_sections(printed)
    sections = [name for name in tab.ask("[...document.querySelectorAll('section')].map(s => s.id)") if name != "play"]
    assert sorted(found) == sorted(sections)
    assert [found[name] for name in sections] == sorted(found.values())
    assert found["answer"] == 1
    assert found["trust"] > 2
    said = re.findall(r'<span data-page-of="(\w+)">(\d*)</span>', printed_pages[1])
    assert said == [(name, str(found[name])) for name in sections]
    assert 'data-page-of="trust"></span>' in page.read_text("utf-8")  # the page itself stays as it is
    assert b"/Outlines" in printed


def test_a_pdf_that_hides_its_structure_is_printed_without_page_numbers():
    assert pdf.pages_of_sections(b"%PDF-1.7 ...") == {}
    text = '<span data-page-of="answer"></span>'
    assert pdf.with_page_numbers(text, {}) == text


def test_the_pdf_is_a4_with_text_that_can_be_searched(page, tmp_path):
    size = write_pdf(page, tmp_path / "report.pdf")
    printed = (tmp_path / "report.pdf").read_bytes()
    assert printed.startswith(b"%PDF-")
    assert size == len(printed)
    boxes = {tuple(map(float, box.split())) for box in re.findall(rb"/MediaBox\s*\[([^\]]*)\]", printed)}
    assert all(box[2:] == pytest.approx((595.0, 842.0), abs=1.5) for box in boxes)
    streams = re.findall(rb"stream\r?\n(.*?)endstream", printed, re.DOTALL)
    fonts = b"".join(_unpacked(stream) for stream in streams)
    assert b"beginbfchar" in fonts or b"beginbfrange" in fonts  # letters, not outlines
    assert [file.name for file in tmp_path.iterdir()] == ["report.pdf"]


def _unpacked(stream):
    try:
        return zlib.decompress(stream)
    except zlib.error:
        return b""


def test_without_a_browser_the_pdf_says_what_to_install(page, tmp_path, monkeypatch):
    monkeypatch.setattr(pdf, "find_browser", lambda: None)
    with pytest.raises(CyclekitError, match="Install Chromium"):
        write_pdf(page, tmp_path / "report.pdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("width", [390, 1180])
def test_axe_finds_nothing_that_shuts_people_out(tab, page, width):
    tab.show(page, width=width, height=900, phone=width < 500)
    tab.ask("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    axe = files("axe_core_python").joinpath("axe.min.js").read_text("utf-8")
    tab.call("Runtime.evaluate", expression=axe)
    found = tab.ask("axe.run(document, {resultTypes: ['violations']}).then(r => JSON.stringify({violations: "
                    "r.violations.map(v => [v.id, v.nodes.length, v.nodes[0].html.slice(0, 200)]), "
                    "passes: r.passes.map(p => p.id)}))")  # fmt: skip
    result = json.loads(found)
    assert result["violations"] == []
    assert {"color-contrast", "svg-img-alt", "heading-order", "html-has-lang", "label"} <= set(result["passes"])

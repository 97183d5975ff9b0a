from __future__ import annotations

import base64
import hashlib
import itertools
import re
import tomllib
from collections import Counter
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from matplotlib.figure import Figure
from msgspec import structs
from report_pages import DistanceModel, Page, estimate

from cyclekit.config.cells import NamedPlace
from cyclekit.dataset.cards import note
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import CyclekitError
from cyclekit.estimate.finding import Finding
from cyclekit.estimate.statistics.distribution import CycleDistribution
from cyclekit.report import compose_report
from cyclekit.report.pictures import Picture


def test_nothing_on_the_page_asks_for_anything_outside_of_it(written):
    text = written.path.read_text("utf-8")
    without_names = re.sub(r'xmlns(:xlink)?="http://www\.w3\.org/[^"]*"', "", text)
    assert "http:" not in without_names
    assert "https:" not in without_names
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text  # the one script that may run is ours
    for name in ("src", "href", "xlink:href"):
        targets = re.findall(rf'\b{name}="([^"]*)"', text)
        assert all(target.startswith(("#", "data:")) for target in targets)
    assert "default-src 'none'" in text


def test_every_element_is_closed_and_every_id_is_unique_and_found(page, written):
    assert page.faults == []
    assert page.open == []
    ids = Counter(attrs["id"] for _, attrs in page.elements if "id" in attrs)
    assert [name for name, n in ids.items() if n > 1] == []
    text = written.path.read_text("utf-8")
    used = set(re.findall(r'href="#([^"]+)"', text)) | set(re.findall(r"url\(#([^)]+)\)", text))
    assert used - set(ids) == set()


def test_headings_come_in_order_and_the_page_is_named(page):
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    assert page.all("html")[0]["lang"] == "en"
    assert "Cell 7" in page.text


def test_every_picture_says_what_it_shows_in_words(page):
    pictures = page.all("svg")
    printed = [attrs for attrs in page.all("div") if attrs.get("class") == "paper"]
    assert len(pictures) == 2 * len(page.all("figure")) + len(printed)
    assert all(attrs["role"] == "img" and len(attrs["aria-label"]) > 20 for attrs in pictures)
    assert all("viewbox" in attrs and "width" not in attrs for attrs in pictures)


def test_sequences_are_ranked_and_the_ones_that_cannot_be_told_apart_are_named(page, written):
    assert written.headline.replace("\N{NO-BREAK SPACE}", " ") == "“A first” takes 30.0 s on average."
    table = page.text[page.text.index("Sequence Rank") :]
    assert table.index("A first") < table.index("C first") < table.index("B first")
    assert "No clear difference between “C first” and “A first”" in page.text
    assert "C first: Thin logs." in page.text


@pytest.mark.usefixtures("words_only")
def test_means_whose_intervals_overlap_are_told_apart_beside_the_same_operators(dataset, tmp_path):
    best = replace(estimate("A first", 30.0, 2.0), beats={"B first": 0.99, "C first": 0.9})
    facts = compose_report(
        dataset,
        None,
        tmp_path / "r.html",
        estimates=[best, estimate("B first", 30.5, 2.0), estimate("C first", 30.4, 2.0)],
    )
    assert "No clear difference between “C first” and “A first”" in Page(facts.path.read_text("utf-8")).text


@pytest.mark.usefixtures("words_only")
def test_a_cycle_time_shows_one_decimal_whatever_its_interval_is(dataset, tmp_path):
    wide = estimate("A first", 123.456, 17.0)
    facts = compose_report(dataset, None, tmp_path / "r.html", estimates=[wide])
    assert facts.headline.replace("\N{NO-BREAK SPACE}", " ") == "“A first” takes 123.5 s on average."


def test_metrics_baselines_and_confusion_are_shown(page):
    assert "always 1" in page.text
    assert "90.0 10.0" in page.text
    assert "Two executions were left out." in page.text


def test_it_says_that_it_is_no_safety_validation(page):
    assert "Not a safety validation" in page.text
    assert "does not verify that the system is safe" in page.text


def test_names_from_the_logs_cannot_become_part_of_the_page(dataset, tmp_path):
    nasty = '<img src=x onerror="alert(1)"> & $\\frac{1}$'
    facts = compose_report(dataset, None, tmp_path / "r.html", estimates=[estimate(nasty)], cell_name=nasty)
    page = Page(facts.path.read_text("utf-8"))
    assert page.all("img") == []
    assert page.faults == []
    assert nasty in page.text


@pytest.mark.usefixtures("words_only")
def test_a_page_that_cannot_be_written_is_one_error_and_leaves_nothing(dataset, tmp_path):
    (tmp_path / "r.html").mkdir()
    with pytest.raises(CyclekitError, match="cannot be written"):
        compose_report(dataset, None, tmp_path / "r.html")
    assert [file.name for file in tmp_path.iterdir()] == ["r.html"]


def test_the_callers_own_matplotlib_style_is_left_alone():
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 31.0, "svg.fonttype": "path"}):
        assert ">words</text>" in Picture("one", "words", _words).wide  # and text stays text
        assert mpl.rcParams["font.size"] == 31.0
        assert mpl.rcParams["svg.fonttype"] == "path"


def _words(width_in):
    figure = Figure(figsize=(width_in, 1.0))
    figure.text(0.0, 0.0, "words")
    return figure


def test_every_text_is_asked_for_and_every_text_asked_for_exists():
    folder = files("cyclekit.report")
    texts = tomllib.loads(folder.joinpath("texts.toml").read_text("utf-8"))
    texts.pop("language")
    read = [file for room in (folder, folder / "figures", folder / "play") for file in room.iterdir()]
    source = "".join(file.read_text("utf-8") for file in read if file.name.endswith((".py", ".jinja", ".js")))
    known = {f"{section}.{name}" for section, names in texts.items() for name in names}
    asked = set(re.findall(r"[\"']((?:page|light|answer|verdict|tiles|where|why|helps|trust|fleet|play)\.\w+)", source))
    no_texts = {
        "light.html",
        "page.css",
        "page.html",
        "page.js",
        "page.pdf",
        "fleet.html",
        "play.css",
        "play.html",
        "tiles.html",
    }
    assert asked - known == no_texts  # but files
    names = set(re.findall(r'"(\w+)"', source))
    assert {key for key in known - asked if key.partition(".")[2] not in names} == set()


@pytest.mark.usefixtures("words_only")
def test_the_takt_is_held_against_single_cycles(dataset, tmp_path):
    cycles = [float(v) for v in range(25, 35)]
    facts = compose_report(
        dataset, None, tmp_path / "r.html", takt_s=27.5,
        estimates=[estimate(distribution=CycleDistribution(np.array(cycles)))],
    )  # fmt: skip
    page = Page(facts.path.read_text("utf-8"))
    assert "32 % within the takt (" in page.text.replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.usefixtures("words_only")
def test_people_are_shown_the_labels_of_places_and_data_keep_the_names(dataset, tmp_path):
    settings = replace(dataset.card.settings, places={"left": NamedPlace((0.0, 0.5, 0.0), label="Left table, slot 2")})
    labelled = Dataset(dataset.path, structs.replace(dataset.card, settings=settings))
    compose_report(labelled, None, tmp_path / "r.html", estimates=[estimate("A first")])
    shown = Page((tmp_path / "r.html").read_text("utf-8")).text
    assert "conveyor → Left table, slot 2" in shown
    assert "→ left" not in shown
    compose_report(labelled, None, tmp_path / "r.csv", estimates=[estimate("A first")], kind="csv")
    assert "conveyor->left," in (tmp_path / "r.csv").read_text("utf-8")


@pytest.mark.usefixtures("words_only")
def test_drawing_is_told_picture_by_picture(dataset, tmp_path):
    told = []
    compose_report(dataset, DistanceModel(), tmp_path / "r.html", progress=lambda *it: told.append(it))
    parts = [part for part, _ in told]
    assert parts == sorted(parts)
    drawn = [text for _, text in told if text.startswith("picture ")]
    assert drawn[0].startswith("picture 1 of ")
    assert len(drawn) == int(drawn[0].rsplit(" ", 1)[1]) > 2
    assert told[-1][1] == "writing the page"


def test_what_limits_several_sequences_is_said_once(dataset, tmp_path):
    ranked = [
        estimate("A first", limits=("Thin logs.",)),
        estimate("B first", 33.0, limits=("Thin logs.", "Bent.")),
    ]
    compose_report(dataset, None, tmp_path / "r.html", estimates=ranked)
    page = (tmp_path / "r.html").read_text("utf-8")
    assert "<li>A first, B first: Thin logs.</li><li>B first: Bent.</li>" in page


@pytest.mark.usefixtures("words_only")
def test_with_a_pose_that_is_only_assumed_the_light_is_red_and_nothing_is_said_of_the_distance(dataset, tmp_path):
    def said(cards, estimates):
        recordings = [structs.replace(one, frame=cards) for one in dataset.card.recordings]
        there = Dataset(dataset.path, structs.replace(dataset.card, recordings=tuple(recordings)))
        facts = compose_report(there, None, tmp_path / "r.html", estimates=estimates)
        return facts, Page(facts.path.read_text("utf-8")).text

    frame = dataset.card.recordings[0].frame
    sound, page = said(frame, [estimate()])
    assert not sound.headline.startswith("Red, ")
    assert "The distance between robot and operator explains" in page
    assumed = structs.replace(frame, method="assumed base frame")
    assert not said(assumed, [])[0].headline.startswith("Red, ")  # a logged mean rests on no pose
    red, page = said(assumed, [estimate()])
    assert red.headline.startswith("Red, not to be trusted: ")
    assert "Red: these numbers cannot be trusted." in page
    assert "`cyclekit calibrate points.csv` computes it" in page
    assert page.index("Red: these numbers") < page.index("Red, not to be trusted")
    assert "safety function acts on distance" not in page
    assert "zones or presence" not in page


@pytest.mark.usefixtures("words_only")
def test_the_light_names_the_sequences_of_a_finding_and_nothing_repeats_it(dataset, tmp_path):
    far = Finding("support", "amber", "15 % of the cycle was never logged", "log this part of the cell")
    two = Finding("several-people", "amber", "two are taken for one", covered=False)
    asked = [
        replace(estimate("A first", 30.0, limits=("Thin logs.",)), findings=(far, two)),
        replace(estimate("B first", 33.0), findings=(two,)),
    ]
    facts = compose_report(with_pose(dataset), None, tmp_path / "r.html", estimates=asked)
    page = Page(facts.path.read_text("utf-8")).text
    assert page.count("15 % of the cycle was never logged") == 1
    assert "Support A first: 15 % of the cycle was never logged: log this part" in page
    assert page.count("two are taken for one") == 1
    assert "Several people two are taken for one" in page
    assert "A first: Thin logs." in page


@pytest.mark.usefixtures("words_only")
def test_what_rests_on_a_doubted_pose_is_marked(dataset, tmp_path):
    given = {"estimates": [estimate()], "kind": "html"}
    sound = with_pose(dataset)
    doubted = Dataset(dataset.path, structs.replace(sound.card, warnings=(note("frame-assumed"),)))
    mark = "This rests on what is red above: it cannot be trusted."
    for logs, marked in ((sound, False), (doubted, True)):
        page = compose_report(logs, DistanceModel(), tmp_path / "r.html", **given).path.read_text("utf-8")
        captions = re.findall(r"<figcaption>(.*?)</figcaption>", page.partition('<section id="why">')[2])
        assert [caption.startswith(mark) for caption in captions[:3]] == [marked] * 3
        for name in ("where", "helps"):
            section = page.partition(f'<section id="{name}">')[2].partition("</section>")[0]
            assert (mark in section) is marked


def with_pose(dataset):
    """The same logs with people whose clock and pose the cell file gives."""
    recordings = [
        structs.replace(
            one,
            clock=structs.replace(one.clock, method="cell-file"),
            frame=structs.replace(one.frame, method="robot base"),
        )
        if "people" in one.tables
        else one
        for one in dataset.card.recordings
    ]
    return Dataset(dataset.path, structs.replace(dataset.card, recordings=tuple(recordings)))

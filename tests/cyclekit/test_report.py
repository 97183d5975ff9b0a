from __future__ import annotations

import base64
import hashlib
import html.parser
import itertools
import json
import math
import re
import shutil
import tomllib
from collections import Counter
from importlib.resources import files

import numpy as np
import polars as pl
import pytest
from fabricated import LEVELS, THRESHOLDS_M, fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st

from cyclekit import colours
from cyclekit.atomic import write_parquet
from cyclekit.dataset import CARD, Dataset
from cyclekit.errors import CyclekitError
from cyclekit.estimate.result import CycleEstimate, TaskShare
from cyclekit.labels import place_labels
from cyclekit.report import findings, load_what_if, numbers, write_report
from cyclekit.report.floor import floor_plan
from cyclekit.report.judged import calibration


class DistanceModel:
    """The true staircase as a model of problem `now`, with the card of a trained one."""

    problem, network = "now", "classifier"

    def __init__(self):
        self.card = {"cyclekit": "0.1.0", "metrics": {"rows": 1234, "mse_mean": 3.2e-4, "accuracy": 0.991, "mae": None}}

    def predict(self, x):
        distance = np.linalg.norm(x[:, :3] - x[:, 3:], axis=1)
        return np.searchsorted(np.array(THRESHOLDS_M), distance) / 4


class Judgement:
    def to_json(self):
        return {
            "mse": [{"name": "classifier", "mse": 3.2e-4, "note": ""}, {"name": "always 1", "mse": 0.21, "note": "x"}],
            "accuracy": 0.98,
            "confusion": [[9, 1], [0, 10]],
            "levels": [{"level": 0.0}, {"level": 1.0}],
            "held_out": True,
            "notes": ["Two executions were left out."],
        }


def estimate(name="A first", mean_s=30.0, half_s=0.6, **changes):
    tasks = (
        TaskShare("conveyor->left", mean_s / 2, 5.0, mean_s / 2 - 6.0, 1.0, 0.0),
        TaskShare("left->conveyor", mean_s / 2, 8.0, mean_s / 2 - 9.0, 1.0, 0.0),
    )
    facts = {
        "name": name,
        "places": ("conveyor", "left", "conveyor"),
        "expected_s": mean_s,
        "expected_low_s": mean_s - half_s,
        "expected_high_s": mean_s + half_s,
        "quantiles_s": {0.05: mean_s - 4, 0.5: mean_s, 0.95: mean_s + 5},
        "nominal_s": 13.0,
        "safety_loss_s": mean_s - 15.0,
        "dwell_s": 2.0,
        "wait_s": 0.0,
        "support": 0.97,
        "tracks": 40,
        "warnings": (),
        "tasks": tasks,
        "safety_by_activity_s": {"shelf": 4.0},
        "durations_s": (mean_s,) * 3,
    }
    return CycleEstimate(**{**facts, **changes})


class Page(html.parser.HTMLParser):
    """The page as a browser sees it: elements in order, and what does not nest."""

    VOID = frozenset({"meta", "link", "br", "img", "hr", "path", "use", "image", "rect", "input"})

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.faults, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if tag in self.VOID:
            return
        if not self.open or self.open.pop() != tag:
            self.faults.append(tag)

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))

    def all(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=4, rounds=1)


@pytest.fixture(scope="module")
def written(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "report.html"
    ranked = [estimate("B first", 33.0), estimate("A first", 30.0), estimate("C first", 30.8, warnings=("Thin logs.",))]
    return write_report(dataset, DistanceModel(), out, estimates=ranked, evaluation=Judgement(), cell_name="Cell 7")


@pytest.fixture(scope="module")
def page(written):
    return Page(written.path.read_text("utf-8"))


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
    assert len(pictures) == 2 * len(page.all("figure"))
    assert all(attrs["role"] == "img" and len(attrs["aria-label"]) > 20 for attrs in pictures)
    assert all("viewbox" in attrs and "width" not in attrs for attrs in pictures)


def test_sequences_are_ranked_and_the_ones_that_cannot_be_told_apart_are_named(page, written):
    assert written.headline.replace("\N{NO-BREAK SPACE}", " ") == "“A first” takes 30.0 s on average."
    table = page.text[page.text.index("Sequence Rank") :]
    assert table.index("A first") < table.index("C first") < table.index("B first")
    assert "C first cannot be told apart from the fastest" in page.text
    assert "C first: Thin logs." in page.text


def test_the_mean_is_rounded_to_what_its_interval_supports(dataset, tmp_path):
    wide = estimate("A first", 123.456, 17.0)
    facts = write_report(dataset, None, tmp_path / "r.html", estimates=[wide])
    assert facts.headline.replace("\N{NO-BREAK SPACE}", " ") == "“A first” takes 123 s on average."


def test_metrics_baselines_and_confusion_are_shown(page):
    assert "always 1" in page.text
    assert "90.0 10.0" in page.text
    assert "Two executions were left out." in page.text


def test_it_says_that_it_is_no_safety_validation(page):
    assert "It is no safety validation" in page.text
    assert "does not verify that the system is safe" in page.text


def test_names_from_the_logs_cannot_become_part_of_the_page(dataset, tmp_path):
    nasty = '<img src=x onerror="alert(1)"> & $\\frac{1}$'
    facts = write_report(dataset, None, tmp_path / "r.html", estimates=[estimate(nasty)], cell_name=nasty)
    page = Page(facts.path.read_text("utf-8"))
    assert page.all("img") == []
    assert page.faults == []
    assert nasty in page.text


def test_the_levels_and_distances_of_the_true_staircase_are_read_back(dataset):
    found = findings.safety_function(dataset.samples(), dataset.levels, DistanceModel())
    assert found.explained > 0.95
    by_level = {band.scaling: band for band in found.bands}
    limits = (0.0, *THRESHOLDS_M, math.inf)
    for level, low, high in zip(LEVELS, limits, limits[1:], strict=False):
        if level in by_level:
            assert low <= by_level[level].low_m <= by_level[level].high_m <= high
    assert np.abs(found.predicted - found.logged).mean() < 0.02


def test_where_speed_does_not_follow_distance_the_page_says_so(dataset, tmp_path):
    rng = np.random.default_rng(0)
    random = pl.Series(rng.choice(LEVELS, dataset.samples().height))
    rows = dataset.samples().with_columns(scaling=random)
    assert findings.safety_function(rows, dataset.levels, None).explained < 0.3


def test_time_lost_on_the_floor_plan_is_the_time_lost_in_the_tasks(dataset):
    plan = floor_plan(dataset, dataset.samples())
    lost_s = plan.lost[:, 2].sum() * dataset.executions.height
    assert lost_s == pytest.approx(dataset.tasks()["safety_loss_s"].sum(), rel=0.1)
    seen = dataset.samples()["human_x_m"].count()
    assert plan.seen[:, 2].sum() * dataset.executions.height == pytest.approx(0.1 * seen)


def test_logged_tasks_keep_their_seconds(dataset):
    rows = findings.task_shares(dataset.tasks())
    tasks = dataset.tasks()
    whole = (tasks["end_s"] - tasks["start_s"]).sum()
    assert sum(row.total_s * row.seen for row in rows) == pytest.approx(whole)
    assert rows[0].safety_s * rows[0].seen == max(row.safety_s * row.seen for row in rows)


@pytest.mark.parametrize(
    ("absent", "sentence"),
    [
        (["scaling", "scaling_origin", "step"], "Speed scaling is not known in these logs"),
        ([f"human_{axis}_m" for axis in "xyz"], "No operator position is in these logs"),
        ([f"robot_{axis}_m" for axis in "xyz"], "too few samples"),
        (["robot_moving", "robot_task", "human_task", "step"], "No sequence was estimated"),
    ],
)
def test_what_the_logs_lack_is_said_on_the_page(dataset, tmp_path, absent, sentence):
    path = tmp_path / "poor"
    shutil.copytree(dataset.path, path)
    for file in (path / "samples").glob("*.parquet"):
        rows = pl.read_parquet(file)
        write_parquet(rows.with_columns(pl.lit(None).cast(rows.schema[c]).alias(c) for c in absent), file)
    facts = write_report(Dataset.open(path), None, tmp_path / "r.html")
    page = Page(facts.path.read_text("utf-8"))
    assert page.faults == []
    assert sentence in page.text
    assert "No model was given" in page.text


def test_a_dataset_without_tasks_executions_or_provenance_still_gives_a_page(dataset, tmp_path):
    path = tmp_path / "bare"
    shutil.copytree(dataset.path, path)
    card = json.loads((path / CARD).read_text())
    bare = {key: card[key] for key in ("schema_version", "places", "human_places")}
    (path / CARD).write_text(json.dumps({**bare, "executions": [], "levels": [], "recordings": []}))
    write_parquet(pl.read_parquet(path / "tasks.parquet").head(0), path / "tasks.parquet")
    for file in (path / "samples").glob("*.parquet"):
        write_parquet(pl.read_parquet(file).head(0), file)
    facts = write_report(Dataset.open(path), DistanceModel(), tmp_path / "r.html")
    assert "no complete execution" in facts.headline
    assert facts.pictures == 0


def test_provenance_is_put_together_where_alike_and_counted(dataset, tmp_path):
    path = tmp_path / "many"
    shutil.copytree(dataset.path, path)
    card = json.loads((path / CARD).read_text())
    record = {
        "id": "r",
        "session": "session-1",
        "tables": ["robot"],
        "adapter": "ur-rtde",
        "adapter_package": "cyclekit",
        "adapter_version": "0.1.0",
        "sources": [{"path": "run.csv", "sha256": "ab" * 32, "size": 3}],
        "clock": {"kind": "uptime", "method": "own clock", "offset_s": 0.0, "rate": 1.0},
        "frame": {"method": "robot base"},
        "rows_read": 1000,
        "rows_set_aside": [{"reason": "time goes back", "count": 2}],
        "rate_hz": 125.0,
        "duration_s": 8.0,
        "warnings": ["Scaling is null while the program is paused."],
    }
    card["recordings"] = [{**record, "id": f"r{n}"} for n in range(40)]
    card["not_read"] = [{"path": "notes.txt", "reason": "no adapter recognises this content"}]
    (path / CARD).write_text(json.dumps(card))
    text = Page(write_report(Dataset.open(path), None, tmp_path / "r.html").path.read_text("utf-8")).text
    assert "time goes back 80" in text
    assert "Scaling is null while the program is paused. (40 recordings)" in text
    assert "28 more are in dataset.json." in text
    assert "notes.txt" in text
    assert text.count("ur-rtde (cyclekit 0.1.0)") == 1


def test_a_page_that_cannot_be_written_is_one_error_and_leaves_nothing(dataset, tmp_path):
    (tmp_path / "r.html").mkdir()
    with pytest.raises(CyclekitError, match="cannot be written"):
        write_report(dataset, None, tmp_path / "r.html")
    assert [file.name for file in tmp_path.iterdir()] == ["r.html"]


def test_the_callers_own_matplotlib_style_is_left_alone(dataset, tmp_path):
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 31.0, "svg.fonttype": "path"}):
        write_report(dataset, None, tmp_path / "r.html")
        assert mpl.rcParams["font.size"] == 31.0
        assert mpl.rcParams["svg.fonttype"] == "path"


def test_every_text_is_asked_for_and_every_text_asked_for_exists():
    folder = files("cyclekit.report")
    texts = tomllib.loads(folder.joinpath("texts.toml").read_text("utf-8"))
    texts.pop("language")
    source = "".join(f.read_text("utf-8") for f in folder.iterdir() if f.name.endswith((".py", ".jinja")))
    known = {f"{section}.{name}" for section, names in texts.items() for name in names}
    asked = set(re.findall(r"[\"']((?:page|answer|where|why|helps|trust|fleet)\.\w+)", source))
    assert asked - known == {"page.css", "page.html", "page.js", "page.pdf", "fleet.html"}  # files, no texts
    names = set(re.findall(r'"(\w+)"', source))
    assert {key for key in known - asked if key.partition(".")[2] not in names} == set()


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e4))
def test_a_rounded_mean_stays_well_inside_its_interval(mean, half):
    text, interval = numbers.with_uncertainty(mean, mean - half, mean + half)
    shown = float(text.replace("−", "-"))
    assert abs(shown - mean) <= max(0.51 * half, 0.0006)
    low, high = (float(part.replace("−", "-")) for part in interval.split(" to "))
    assert low <= high


@given(st.one_of(st.sampled_from([None, math.nan, math.inf, -math.inf]), st.floats(-1e15, 1e15)))
def test_no_number_is_ever_written_as_nan(value):
    for write in (numbers.seconds, numbers.percent, numbers.significant):
        text = write(value)
        assert "nan" not in text
        assert "inf" not in text
        assert "e+" not in text


@pytest.mark.parametrize(
    ("half", "decimals"), [(0.6, 1), (0.19, 2), (0.2, 1), (1.5, 1), (3.0, 0), (17.0, 0), (40.0, -1), (0.0, 2)]
)
def test_decimals_follow_the_uncertainty(half, decimals):
    assert numbers.decimals_for(half) == decimals


def _seen_by(rgb, kind):
    """Linear RGB as seen with a full colour blindness (Viénot, Brettel and Mollon 1999)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    matrices = {
        "none": np.eye(3),
        "red": np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]]),
        "green": np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]]),
    }
    return np.clip(linear @ matrices[kind].T, 0, 1)


def _lab(linear):
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = linear @ to_xyz.T / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


@pytest.mark.parametrize("kind", ["none", "red", "green"])
def test_the_levels_are_told_apart_by_colour_blind_people_too(kind):
    lab = _lab(_seen_by(colours.scaling_rgb(LEVELS) / 255.0, kind))
    apart = [np.linalg.norm(lab[a] - lab[b]) for a in range(5) for b in range(a)]
    assert min(apart) > 15


def test_unknown_scaling_is_grey_and_values_outside_are_clipped():
    assert tuple(colours.scaling_rgb(np.nan)) == colours.to_rgb(colours.UNKNOWN)
    assert colours.scaling_hex(1.7) == colours.scaling_hex(1.0)
    assert colours.scaling_rgb(np.zeros((3, 2))).shape == (3, 2, 3)


@pytest.mark.parametrize("colour", [colours.OPERATOR, colours.ROBOT, colours.PREDICTED, "#1c232b", "#55606c"])
def test_words_on_the_page_stand_out_from_white(colour):
    linear = _seen_by(np.array(colours.to_rgb(colour)) / 255.0, "none")
    luminance = float(linear @ np.array([0.2126, 0.7152, 0.0722]))
    assert 1.05 / (luminance + 0.05) >= 4.5


def test_close_places_of_one_family_share_a_label_and_distant_ones_do_not(dataset):
    from cyclekit.dataset import Place

    row = {f"left_{n}": Place(f"left_{n}", (0.2 * n, 1.0, 0.0), 0.1, inferred=False) for n in (1, 2, 3)}
    assert [label.text for label in place_labels(row)] == ["left_1 … left_3"]
    far = {f"table_{n}": Place(f"table_{n}", (2.0 * n, 1.0, 0.0), 0.1, inferred=False) for n in (1, 2)}
    assert [label.text for label in place_labels(far)] == ["table_1", "table_2"]
    assert [label.text for label in place_labels(dataset.places)] == list(dataset.places)


def test_the_report_as_json_gives_every_number_unrounded(dataset, tmp_path):
    one = estimate("A first", 30.123456)
    facts = write_report(
        dataset, DistanceModel(), tmp_path / "r.json", estimates=[one], evaluation=Judgement(), kind="json"
    )  # fmt: skip
    document = json.loads(facts.path.read_text("utf-8"))
    assert document["sequences"] == [one.to_json()]
    assert sum(task["total_s"] * task["seen"] for task in document["logged_tasks"]) == pytest.approx(
        (dataset.tasks()["end_s"] - dataset.tasks()["start_s"]).sum()
    )
    assert document["evaluation"] == Judgement().to_json()
    assert {level["scaling"] for level in document["levels"]} <= set(LEVELS)


def test_the_report_as_csv_adds_up(dataset, tmp_path):
    facts = write_report(dataset, None, tmp_path / "r.csv", estimates=[estimate()], kind="csv")
    rows = pl.read_csv(facts.path)
    tasks = rows.filter(pl.col("order") > 0)
    parts = tasks.select(pl.sum_horizontal("nominal_s", "safety_loss_s", "dwell_s", "wait_s")).to_series()
    assert parts.to_list() == pytest.approx(tasks["expected_s"].to_list())
    assert rows.filter(pl.col("order") == 0)["low_s"].to_list() == [29.4]
    logged = pl.read_csv(write_report(dataset, None, tmp_path / "l.csv", kind="csv").path)
    assert logged["seen"].sum() == dataset.tasks().height


def test_the_report_as_markdown_has_every_table_whole(dataset, written, tmp_path):
    ranked = [estimate("A | first"), estimate("B first", 33.0)]
    facts = write_report(dataset, DistanceModel(), tmp_path / "r.md", estimates=ranked, kind="md")
    text = facts.path.read_text("utf-8")
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        "## 1 The answer",
        "## 2 Where the time goes",
        "## 3 Why the robot is slowed",
        "## 4 What would help",
        "## 5 Can it be believed",
    ]
    assert "A \\| first" in text
    assert "This is no safety validation" in text
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        columns = {len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}
        assert len(columns) == 1


def test_the_takt_is_held_against_single_cycles(dataset, tmp_path):
    cycles = tuple(float(v) for v in range(25, 35))
    facts = write_report(
        dataset, None, tmp_path / "r.html", estimates=[estimate(durations_s=cycles)], takt_s=27.5
    )  # fmt: skip
    page = Page(facts.path.read_text("utf-8"))
    assert (
        "Within a takt of 27.5 s stay 30 % of its cycles, as counted on 10 logged operator tracks."
        in page.text.replace("\N{NO-BREAK SPACE}", " ")
    )


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


def test_time_lost_is_laid_to_what_the_operator_did(dataset):
    found = findings.losses(dataset.samples(), dataset.executions.height)
    assert sum(loss.seconds for loss in found) * dataset.executions.height == pytest.approx(
        dataset.tasks()["safety_loss_s"].sum(), rel=0.1
    )
    assert all(loss.worst_s <= loss.seconds for loss in found)
    assert [loss.seconds for loss in found] == sorted((loss.seconds for loss in found), reverse=True)


def test_the_zone_map_is_the_models_mean_over_the_robots_ways(dataset):
    samples = dataset.samples()
    plan = floor_plan(dataset, samples, DistanceModel())
    assert plan.zones_of_model
    near = plan.zones[np.argmin(np.linalg.norm(plan.zones[:, :2] - [0.6, 0.0], axis=1))]
    far = plan.zones[np.argmax(np.linalg.norm(plan.zones[:, :2], axis=1))]
    assert near[2] < far[2]
    assert not floor_plan(dataset, samples).zones_of_model


def test_a_calibrated_model_lies_on_the_line_and_a_biased_one_does_not(dataset):
    class Biased(DistanceModel):
        def predict(self, x):
            return super().predict(x) * 0.5

    names = dataset.executions["execution"].to_list()
    right = calibration(dataset.samples(), names, DistanceModel())
    assert right.worst < 0.02
    assert calibration(dataset.samples(), names, Biased()).worst > 0.3
    assert calibration(dataset.samples(), [], DistanceModel()) is None


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
    facts = write_report(dataset, None, tmp_path / "r.html", template=house, cell_name="Cell 7")
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
        ("page.html.jinja", "{{ nothing }}", "the template cannot be set"),
        ("page.html.jinja", "{{ ''.__class__.__mro__ }}", "the template cannot be set"),
    ],
)
def test_a_template_that_is_wrong_is_named_and_nothing_is_written(dataset, house, tmp_path, name, content, said):
    (house / name).write_text(content, "utf-8")
    with pytest.raises(CyclekitError, match=said):
        write_report(dataset, None, tmp_path / "out" / "r.html", template=house)
    assert not (tmp_path / "out" / "r.html").exists()


def test_a_folder_without_a_template_is_refused(dataset, tmp_path):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(CyclekitError, match="Put one or more of these files there"):
            write_report(dataset, None, tmp_path / "r.html", template=folder)

"""A project: begun in a folder of logs, brought up to date, and where commands find what was left out."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from cyclekit.api.init import first_jobs
from cyclekit.config.project import Project, load_project, project_to_toml
from cyclekit.config.sequences import load_sequences
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.plan.jobs import load_jobs
from cyclekit.learning.unseen.saved import holds_unseen
from cyclekit.text.durations import seconds_in
from cyclekit_sim import simulate
from cyclekit_sim.task_lists import simulate_task_lists

if TYPE_CHECKING:
    from .conftest import Shell

pytestmark = pytest.mark.usefixtures("words_only", "simple_rules")


@pytest.fixture
def home(logs: Path, dataset: Path, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with dataset and model of the logs, in which commands are typed."""
    shutil.copytree(dataset, tmp_path / "dataset")
    shutil.copytree(model, tmp_path / "model")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def begun(home: Path, logs: Path, cyclekit: Shell, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project; no order is searched in it, which takes long."""
    monkeypatch.setattr("cyclekit.fleet.project.first_jobs", lambda _dataset, _project: None)
    assert cyclekit("init", logs, "--takt", "105s", "--yes").code == 0
    return home


def test_init_says_what_it_found_and_writes_a_project_that_reads_back(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(logs, tmp_path / "cell" / "logs", ignore=shutil.ignore_patterns("truth", "cell.toml"))
    monkeypatch.chdir(tmp_path / "cell")
    typed = cyclekit("init", "--takt", "1min 45s", "--yes")
    assert typed.code == 0, typed.err
    assert "ur-rtde" in typed.out
    assert "cyclekit run" in typed.out
    project = load_project(Path())
    assert (project.name, project.logs, project.cell, project.takt_s) == ("cell", ("logs",), "cell.toml", 105.0)
    assert not Path("sequences.toml").exists()  # no order is known before there is a dataset


def test_init_shows_what_reading_the_logs_warns_of(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    shutil.copytree(logs, tmp_path / "logs", ignore=shutil.ignore_patterns("truth"))
    robot = next((tmp_path / "logs").rglob("robot.csv"))
    *rows, last = robot.read_text("utf-8").splitlines()
    sep = "," if "," in last else " "
    values = last.split(sep)
    robot.write_text("\n".join([*rows, sep.join([*values[:1], "nan", *values[2:]])]) + "\n", "utf-8")
    monkeypatch.chdir(tmp_path)
    done = cyclekit("init", "logs", "--yes")
    assert done.code == 0
    assert "warning: " in done.err
    assert "robot.csv: 1 values are written as NaN" in done.err
    Path("cyclekit.toml").unlink()
    monkeypatch.setattr("cyclekit.api.init.READ_BYTES", 10)
    large = cyclekit("init", "logs", "--yes")
    assert "warning: " not in large.err
    assert "their warnings: cyclekit inspect LOGS" in large.err


def test_the_help_names_arguments_without_their_types(cyclekit: Shell) -> None:
    lists = cyclekit("ingest", "--help").out
    assert "LOGS  Logs: files and folders" in lists
    assert "WHAT <ingest|train|report|all>" in cyclekit("fleet", "--help").out


def test_init_counts_the_tables_whose_map_it_drafts(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    shutil.copytree(logs, tmp_path / "logs", ignore=shutil.ignore_patterns("truth", "cell.toml"))
    rows = "".join(f"{row * 40};{100 * row};{200 + row}\n" for row in range(50))
    for number in (1, 2):
        (tmp_path / "logs" / f"tracker_{number}.csv").write_text("time_ms;pos_x_mm;pos_y_mm\n" + rows, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    done = cyclekit("init", "logs", "--yes")
    assert "not read" not in done.err
    assert re.search(r"csv, by the map drafted in cell.toml +2\n", done.out)


def test_init_says_where_a_drafted_map_is_not_sure(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    shutil.copytree(logs, tmp_path / "logs", ignore=shutil.ignore_patterns("truth", "cell.toml"))
    rows = "".join(
        f"{row * 40};3;{row / 10:.1f};{2.0 + row / 90:.3f};{row / 10 + 0.1:.1f};{row / 90:.3f}\n" for row in range(50)
    )
    head = "time_ms;body_id;pelvis_x;pelvis_y;head_x;head_y\n"
    (tmp_path / "logs" / "skeletons.csv").write_text(head + rows, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    done = cyclekit("init", "logs", "--yes")
    assert done.code == 0
    assert 'look for "# ?" in cell.toml' in done.out + done.err
    failed = cyclekit("run")
    assert 'choose among the lines that begin with "# ?"' in " ".join((failed.out + failed.err).split())


def test_init_with_a_dataset_writes_the_order_that_was_logged_most_often(begun: Path, dataset: Path) -> None:
    from cyclekit.dataset.dataset import Dataset

    (sequence,) = load_sequences(begun / "sequences.toml")
    assert sequence.places in {one.places for one in Dataset.open(dataset).card.executions if one.complete}


def test_init_never_replaces_a_project_and_begins_none_among_the_logs(
    begun: Path, logs: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell, tmp_path: Path
) -> None:
    before = Path("cyclekit.toml").read_bytes()
    again = cyclekit("init", logs, "--yes")
    assert (again.code, Path("cyclekit.toml").read_bytes()) == (1, before)
    monkeypatch.chdir(logs)
    inside = cyclekit("init", "--yes")
    assert inside.code == 1
    assert f"cyclekit init {logs.name}" in inside.err
    assert not (logs / "cyclekit.toml").exists()


def test_init_asks_for_the_takt_on_a_terminal_alone(
    home: Path, logs: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    import io

    class Typing(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr("sys.stdin", Typing("98s\n"))
    assert cyclekit("init", logs).code == 0
    assert load_project(Path()).takt_s == 98.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no 'logs'"),
        ("logs = []", "logs = []"),
        ('logs = ["a"]\ntakt = "soon"', "'soon' is not a duration"),
        ('logs = ["a"]\ndatset = "d"', "the nearest is 'dataset'"),
    ],
)
def test_a_project_that_cannot_be_followed_is_named(
    text: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cyclekit.toml").write_text(text, encoding="utf-8")
    for words in (["run"], ["train"]):
        typed = cyclekit(*words)
        assert typed.code == 1
        assert "cyclekit.toml" in typed.err
        assert said in typed.err


_WORDS = st.text(st.characters(blacklist_categories=["Cs", "Cc"], blacklist_characters="/\\"), min_size=1, max_size=12)


@given(logs=st.lists(_WORDS.filter(lambda word: word.strip(".") != ""), min_size=1, max_size=3), name=_WORDS)
def test_a_project_file_reads_back(logs: list[str], name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    from cyclekit.text.plain_text import one_line

    file = tmp_path_factory.mktemp("read") / "cyclekit.toml"
    file.write_text(project_to_toml(Project(tuple(logs), name=name)), encoding="utf-8")
    back = load_project(file)
    assert back.name == one_line(name)
    assert [Path(each).name for each in back.logs] == [Path(one_line(each)).name for each in logs]


def test_a_baseline_of_the_project_counts_for_its_own_sequences(begun: Path, sequences: Path, cyclekit: Shell) -> None:
    (own,) = load_sequences(begun / "sequences.toml")
    file = begun / "cyclekit.toml"
    text = file.read_text("utf-8").replace('# baseline = "left table first"', f'baseline = "{own.name}"')
    file.write_text(text, encoding="utf-8")
    typed = cyclekit("estimate", "--no-check", "--extrapolate")
    assert typed.code == 0, typed.err
    assert f"baseline = {own.name}" in typed.err
    other = cyclekit("estimate", sequences, "--no-check", "--extrapolate")
    assert other.code == 0, other.err
    assert "baseline" not in other.err


def test_commands_find_in_the_project_what_was_left_out_and_what_is_typed_wins(
    begun: Path, sequences: Path, cyclekit: Shell
) -> None:
    left_out = cyclekit("estimate", sequences, "--no-check", "--json")
    assert left_out.code == 0, left_out.err
    assert "from cyclekit.toml: model = model, dataset = dataset, takt = 105s" in left_out.err
    assert {one["name"] for one in left_out.document["sequences"]} == {"one way", "two boxes"}
    assert {one["takt_s"] for one in left_out.document["sequences"]} == {105.0}
    typed = cyclekit("estimate", "model", sequences, "--dataset", "dataset", "--no-check", "--json", "--quiet")
    assert {one["takt_s"] for one in typed.document["sequences"]} == {None}  # the takt is of the project's dataset
    assert "cyclekit.toml" not in typed.err
    assert cyclekit("estimate", "nothing", "--quiet").code == 1
    looked = cyclekit("inspect")
    assert looked.out.startswith("dataset: dataset")
    shutil.rmtree("dataset")
    assert "path = " in cyclekit("inspect").err  # the logs


def test_help_in_a_project_shows_no_defaults_of_it(begun: Path, cyclekit: Shell) -> None:
    assert begun.joinpath("cyclekit.toml").exists()
    for typed in (["ingest", "--help"], ["estimate", "-h"], ["gate", "--takt", "1s", "--help"]):
        shown = cyclekit(*typed)
        assert shown.code == 0
        assert "[required]" in shown.out
        assert "functools" not in shown.out


def test_the_logs_of_the_project_come_with_its_cell_file(begun: Path, logs: Path, cyclekit: Shell) -> None:
    shutil.copytree(logs, begun / "other")
    shutil.copyfile(logs / "cell.toml", begun / "mine.toml")
    file = begun / "cyclekit.toml"
    file.write_text(re.sub(r"(?m)^(# )?cell = .*$", 'cell = "mine.toml"', file.read_text("utf-8")), "utf-8")
    typed = cyclekit("ingest", logs, "--out", "new")
    assert "from cyclekit.toml: cell = mine.toml" in typed.err
    assert "cell = " not in cyclekit("ingest", "other", "--out", "newer").err


def test_without_a_project_an_argument_left_out_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cyclekit("estimate").code == 2
    Path("cyclekit.toml").write_text('logs = ["logs"]\n', encoding="utf-8")
    typed = cyclekit("plan")
    assert typed.code == 1
    assert "model: no such folder" in typed.err


def test_a_jobs_file_that_is_not_there_is_shown_by_example(begun: Path, cyclekit: Shell) -> None:
    typed = cyclekit("plan")
    assert typed.code == 1
    assert "jobs.toml: no such file" in typed.err
    assert "visit = [" in typed.err


def test_a_file_of_changes_finds_model_sequences_and_dataset_in_the_project(begun: Path, cyclekit: Shell) -> None:
    Path("changes.toml").write_text('[[change]]\nname = "a"\nlatency_s = 1e9\n', encoding="utf-8")
    Path("sequences.toml").write_text('[[sequence]]\nname = "x"\nplaces = ["home", "moon"]\n', encoding="utf-8")
    for words in (("changes.toml",), ("sequences.toml", "changes.toml"), ("model", "sequences.toml", "changes.toml")):
        typed = cyclekit("whatif", *words)
        assert typed.code == 1
        assert "latency_s 1000000000.0" in typed.err  # the changes were read, and are refused
        assert ("sequences = sequences.toml" in typed.err) is (len(words) == 1)
        assert ("model = model" in typed.err) is (len(words) < 3)


def test_the_next_run_aligns_clocks_as_the_project_says(begun: Path, cyclekit: Shell) -> None:
    file = begun / "cyclekit.toml"
    file.write_text(re.sub(r"(?m)^# align_clocks", "align_clocks", file.read_text("utf-8")), "utf-8")
    assert states(cyclekit("run", "--json"))["ingest"] == "done"
    assert Dataset.open("dataset").card.settings.align_clocks == "logs"
    assert "up to date" in cyclekit("ingest").out


def test_run_says_how_to_keep_what_was_typed_at_ingest(begun: Path, logs: Path, cyclekit: Shell) -> None:
    assert cyclekit("ingest", "--align-clocks", "logs", "--rate", "20", "--keep-skeletons").code == 0
    told = cyclekit("run", "--json")
    (text,) = (row["text"] for row in told.document["rows"] if row["stage"] == "ingest")
    for kept in ('align_clocks = "logs"', "rate_hz = 20"):
        assert f"the last dataset had {kept}" in text
    assert "cell file" in text
    assert Dataset.open("dataset").card.skeletons  # no file can say so
    again = {row["stage"]: row["text"] for row in cyclekit("run", "--json").document["rows"]}
    assert "last dataset" not in again["ingest"]


def test_run_never_puts_names_back_that_were_taken_out(begun: Path, cyclekit: Shell) -> None:
    assert cyclekit("ingest", "--pseudonymise").code == 0
    told = cyclekit("run", "--json")
    assert states(told)["ingest"] == "failed"
    assert "pseudonymise = true" in told.document["rows"][0]["text"]
    assert Dataset.open("dataset").card.pseudonymised
    file = begun / "cyclekit.toml"
    file.write_text(re.sub(r"(?m)^# pseudonymise", "pseudonymise", file.read_text("utf-8")), "utf-8")
    assert states(cyclekit("run", "--json"))["ingest"] == "unchanged"
    assert "up to date" in cyclekit("ingest").out


def test_run_does_what_changed_and_nothing_else(begun: Path, sequences: Path, cyclekit: Shell) -> None:
    shutil.copy(sequences, "sequences.toml")
    first = states(cyclekit("run", "--json"))
    assert first == {"ingest": "unchanged", "train": "unchanged", "estimate": "done", "report": "done"}
    assert Path("report.html").exists()
    assert states(cyclekit("run", "--json")) == dict.fromkeys(first, "unchanged")
    text = Path("cyclekit.toml").read_text(encoding="utf-8")
    Path("cyclekit.toml").write_text(text.replace("105s", "99s"), encoding="utf-8")
    assert states(cyclekit("run", "--json")) == first
    Path("sequences.toml").write_text('[[sequence]]\nname = "x"\nplaces = ["home", "moon"]\n', encoding="utf-8")
    failed = cyclekit("run", "--json")
    assert failed.code == 1
    assert states(failed) == first | {"estimate": "failed"}  # the page is written without estimates


def test_run_shows_the_warnings_of_dataset_and_model(
    begun: Path, sequences: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    shutil.copy(sequences, "sequences.toml")
    said = [f"limit {number}" for number in range(11)]
    monkeypatch.setattr("cyclekit.fleet.project.texts", lambda _: said)
    typed = cyclekit("run", "--json")
    assert typed.document["warnings"] == said
    assert "warning: limit 0" in typed.err
    assert "3 more warnings: cyclekit inspect" in typed.err


def states(typed) -> dict[str, str]:
    return {row["stage"]: row["state"] for row in typed.document["rows"]}


@pytest.mark.slow
def test_run_goes_the_whole_way_from_an_empty_folder(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cyclekit: Shell
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cyclekit("init", logs, "--yes", "--quiet").code == 0
    typed = cyclekit("run", "--json")
    assert typed.code == 0, typed.err
    assert set(states(typed).values()) == {"done"}
    judged = cyclekit("gate", "--takt", "10min", "--share", "0.5", "--quiet")
    assert judged.code == 2
    assert "6 logged executions are too few" in judged.out


@pytest.mark.parametrize(
    ("orders", "drafted"),
    [
        (["h a l a m a r h", "h a m a l a r h"], True),
        (["h a l a m a r h", "h a l a m a r h"], False),  # always in one order: it may have a reason
        (["h l m r h", "h m l r h"], False),  # what belongs to one job is not told
        (["h a l a l a r h", "h a l a r a l h"], False),
    ],
)
def test_the_work_to_order_is_drafted_where_the_logs_show_that_its_order_is_free(
    orders: list[str], drafted: bool, dataset: Path, tmp_path: Path
) -> None:
    made = Dataset.open(dataset)
    cards = made.card.executions[: len(orders)]
    logged = [structs.replace(card, places=tuple(order.split())) for card, order in zip(cards, orders, strict=True)]
    of_orders = Dataset(made.path, structs.replace(made.card, executions=tuple(logged)))
    file = first_jobs(of_orders, Project(("logs",), jobs=str(tmp_path / "jobs.toml")))
    if drafted:
        assert file is not None
        found = load_jobs(file)
        assert (found.start, found.via, set(found.visit), found.end) == ("h", "a", {"l", "m", "r"}, "h")
        assert first_jobs(of_orders, Project(("logs",), jobs=str(file))) is None  # a file is never replaced
    else:
        assert file is None


def test_run_searches_the_order_and_prices_the_changes_of_the_project(begun: Path, cyclekit: Shell) -> None:
    slots = sorted({goal for goal in Dataset.open("dataset").tasks()["goal_place"] if goal.startswith("left")})[:2]
    (begun / "jobs.toml").write_text(f'start = "home"\nvia = "conveyor"\nvisit = {slots}\n'.replace("'", '"'))
    (begun / "changes.toml").write_text('[[change]]\nname = "half as many visits"\nfrequency = 0.5\n')
    assert cyclekit("run", "--quiet").code == 0
    page = (begun / "report.html").read_text("utf-8")
    assert "order found" in page
    assert "half as many visits" in page
    assert set(states(cyclekit("run", "--json")).values()) == {"unchanged"}
    (begun / "changes.toml").write_text('[[change]]\nname = "a third of the visits"\nfrequency = 0.33\n')
    assert states(cyclekit("run", "--json"))["report"] == "done"


@given(st.floats(0.001, 2000.0), st.sampled_from(["s", "", " s", "min", "ms", "h"]))
def test_a_duration_is_read_in_its_unit(value: float, unit: str) -> None:
    scale = {"min": 60.0, "ms": 0.001, "h": 3600.0}.get(unit, 1.0)
    assert seconds_in(f"{value!r}{unit}") == pytest.approx(value * scale)


@given(st.integers(0, 99), st.integers(0, 59), st.integers(1, 59))
def test_parts_of_a_duration_add_up(hours: int, minutes: int, seconds: int) -> None:
    assert seconds_in(f"{hours}h {minutes}min {seconds}s") == 3600 * hours + 60 * minutes + seconds


@pytest.mark.parametrize("text", ["", "0", "-3s", "nan", "inf", "45s 1min", "1min 45", "1:45", "3 x", "1s 2s", "1e999"])
def test_what_is_no_duration_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="duration"):
        seconds_in(text)


def test_inspect_and_a_refused_estimate_say_what_to_log_next(begun: Path, cyclekit: Shell) -> None:
    Path("far.toml").write_text('[[sequence]]\nname = "far"\nplaces = ["left_1", "left_2"]\n', encoding="utf-8")
    refused = cyclekit("estimate", "far.toml", "--no-check", "--quiet")
    assert refused.code == 1
    assert "log 5 executions of left_1, left_2 (sequence 'far')" in refused.err
    looked = cyclekit("inspect", "--sequences", "far.toml", "--quiet")
    assert "What to log next\n- missing: left_1->left_2" in looked.out
    assert cyclekit("inspect", "--json", "--quiet").document["to_log"]["executions"] == 6


@pytest.mark.usefixtures("quick_task_times")
def test_a_project_of_task_lists_reports_its_plans(tmp_path: Path, monkeypatch, cyclekit: Shell) -> None:
    simulate_task_lists(tmp_path / "all", executions=8, seed=4)
    (tmp_path / "logs").mkdir()
    shutil.move(tmp_path / "all" / "tasks.csv", tmp_path / "logs" / "tasks.csv")
    monkeypatch.chdir(tmp_path)
    assert cyclekit("init", "logs", "--takt", "70s", "--yes").code == 0
    done = cyclekit("run")
    assert done.code == 0, done.out
    assert "Who waits for what" in Path("report.html").read_text(encoding="utf-8")
    assert re.search("usual order|a logged order", Path("report.html").read_text(encoding="utf-8"))
    assert " ".join(cyclekit("run").out.split()).count("unchanged") == 4
    with Path("sequences.toml").open("a", encoding="utf-8") as file:
        file.write('\n[[sequence]]\nname = "new"\n[[sequence.task]]\nagent = "robot"\nname = "fly"\n')
    rows = {row["stage"]: row for row in cyclekit("run", "--json").document["rows"]}
    assert (rows["estimate"]["state"], rows["report"]["state"]) == ("done", "done")
    assert "not answered: sequences.toml: sequence 'new'" in rows["report"]["text"]


def test_a_project_whose_logs_show_nobody_is_estimated(tmp_path: Path, monkeypatch, cyclekit: Shell) -> None:
    simulate("light-curtain", tmp_path / "all", executions=4, seed=2)
    shutil.copytree(tmp_path / "all" / "session_000", tmp_path / "logs", ignore=shutil.ignore_patterns("plc.csv"))
    monkeypatch.chdir(tmp_path)
    assert cyclekit("init", "logs", "--yes").code == 0
    states = {row["stage"]: row["state"] for row in cyclekit("run", "--json").document["rows"]}
    assert holds_unseen("model")
    assert states == {"ingest": "done", "train": "done", "estimate": "done", "report": "done"}
    assert {row["state"] for row in cyclekit("run", "--json").document["rows"]} == {"unchanged"}


def test_a_sequence_file_that_is_not_there_is_shown_by_example(begun: Path, cyclekit: Shell) -> None:
    (begun / "sequences.toml").unlink()
    said = cyclekit("gate", "--takt", "60s")
    assert said.code == 2
    assert "sequences.toml: no such file" in said.err
    assert "[[sequence]]" in said.err

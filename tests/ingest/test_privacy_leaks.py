"""Nothing of the names and times that go into a pseudonymised dataset comes out of it: every byte is looked at."""

from __future__ import annotations

import datetime as dt
import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from cyclekit.api.train import Training, train_at
from cyclekit.cli import run
from cyclekit.config.cells import Cell, OperatorSignal
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, LogError
from cyclekit.fleet import load_fleet
from cyclekit.fleet.stages import run_stages
from cyclekit.ingest.free_text import Words, without_times
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.spec import ModelSpec

EPOCH_S = 1_760_000_152.512
NAMES = ("Anna", "Muster", "Kowalski", "track-4711")
DAY = dt.datetime.fromtimestamp(EPOCH_S, tz=dt.UTC)
TEXTS = (*NAMES, "17600001", "17600002", "1.76e", *(DAY.strftime(form) for form in ("%Y-%m-%d", "%Y%m%d", "%d.%m.%Y")))
NEAR_S = 1000.0


def found_in(text: str) -> set[str]:
    return {name for name in TEXTS if name.lower() in text.lower()}


def times_in(numbers: np.ndarray) -> bool:
    """Tell whether one of the numbers is a time of the logs, in seconds, ms, us or ns."""
    with np.errstate(invalid="ignore", over="ignore"):
        return any(np.any(np.abs(np.abs(numbers) / unit - EPOCH_S) < NEAR_S) for unit in (1.0, 1e3, 1e6, 1e9))


def leaks(file: Path) -> set[str]:
    """Return what of the names and times is in a file: in its bytes, and in its values where they are packed."""
    content = file.read_bytes()
    found = found_in(content.decode("latin-1"))
    for begin in range(8):
        words = content[begin : begin + (len(content) - begin) // 8 * 8]
        if times_in(np.frombuffer(words, "<f8")) or times_in(np.frombuffer(words, "<i8").astype(np.float64)):
            found.add("a time, as eight bytes")
    if file.suffix == ".parquet":
        frames = [pl.read_parquet(file)]
    elif file.suffix == ".rrd":
        frames = [pl.from_arrow(chunk.to_record_batch()) for chunk in RrdReader(file).stream()]
    else:
        frames = []
    for frame in frames:
        found |= found_in(" ".join(frame.columns))
        for column in frame.get_columns():
            while column.dtype in (pl.List, pl.Array):
                column = column.explode()
            if column.dtype.is_temporal():
                column = column.cast(pl.Int64)
            if column.dtype.is_numeric():
                found |= {f"a time in {column.name}"} if times_in(column.cast(pl.Float64).to_numpy()) else set()
            else:
                found |= found_in(" ".join(map(str, column.drop_nulls().unique().to_list())))
    return found


def leaking(folder: Path) -> dict[str, set[str]]:
    """Return what leaks by file, the names of files and folders included."""
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*")}
    found = {name: found_in(name) | (leaks(path) if path.is_file() else set()) for name, path in files.items()}
    return {name: what for name, what in found.items() if what}


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot and its operator, every name a name and every clock a wall clock that no adapter declares to be one."""
    folder = tmp_path_factory.mktemp("named") / f"{DAY:%Y-%m-%d}_Anna_Muster"
    folder.mkdir()
    t_s = np.arange(2400) / 20
    phase = t_s % 12 / 12
    x_m = np.interp(phase, [0, 0.2, 0.5, 0.7, 1], [0, 0, 0.8, 0.8, 0])
    near = t_s // 12 % 2 > 0
    rows = zip(EPOCH_S + t_s, x_m, np.where(near, 0.5, 1.0), strict=True)
    header = "timestamp actual_TCP_pose_0 actual_TCP_pose_1 actual_TCP_pose_2 speed_scaling runtime_state"
    lines = [f"{at:.3f} {x:.5f} 0.1 0.4 {scaling} 2" for at, x, scaling in rows]
    lines[700:700] = ["1760000152.5 Kowalski was here 1 2"]
    (folder / f"rtde_{DAY:%Y%m%d}_Muster.csv").write_text("\n".join([header, *lines, ""]), encoding="utf-8")
    far_m = np.where(near, 0.5, 2.0)
    people = {
        "t": EPOCH_S + 0.25 + t_s,
        "id": ["Anna Muster"] * len(t_s),
        "x": far_m,
        "y": 0 * t_s + 0.8,
        "z": 0 * t_s + 1,
    }
    pl.DataFrame(people).write_csv(folder / "Anna Muster.csv")
    said = [(EPOCH_S + 1, "shift", f"begin {DAY.isoformat()}"), (EPOCH_S + 2, "stamp", f"{EPOCH_S * 1e3:.0f}")]
    cells = [f"{at:.3f},{signal},{value}" for at, signal, value in said]
    (folder / "events_09.10.2025.csv").write_text("\n".join(["time_s,signal,value", *cells, ""]), encoding="utf-8")
    (folder / "Kowalski_2025-10-09.docx").write_bytes(b"no log")
    (folder / "cell.toml").write_text(
        '[[sources]]\npath = "rtde*_Muster.csv"\n'
        '[[sources]]\npath = "Anna*.csv"\nadapter = "csv"\nrole = "people"\n'
        'map = { time = "t", x = "x", y = "y", z = "z", person = "id" }\nclock_offset_s = -0.25\n'
        '[[sources]]\npath = "track-4711.csv"\n',
        encoding="utf-8",
    )
    return folder


@pytest.fixture(scope="module")
def made(named: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that can be made of the logs, in a folder, with what the commands said."""
    out = tmp_path_factory.mktemp("made")
    data = str(out / "dataset")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(out)
        assert run(["ingest", str(named), "--out", data, "--pseudonymise", "--quiet"]) == 0
        train_at(Training(data, ModelSpec.of(network="regressor", epochs=1, batch=256), str(out / "model")))
        assert run(["replay", data, "--execution", "1", "--model", "model", "--out", "replay.rrd", "--quiet"]) == 0
        assert run(["report", data, "--model", "model", "--out", "page.html", "--quiet"]) == 0
        for kind in ("json", "csv", "md"):
            assert run(["report", data, "--out", f"report.{kind}", "--quiet"]) == 0
    return out


@pytest.mark.slow
def test_no_byte_of_dataset_model_replay_and_report_tells_a_name_or_a_time_of_the_logs(made: Path) -> None:
    assert not leaking(made)


def test_the_same_search_finds_them_where_they_were_not_taken_out(named: Path, tmp_path: Path) -> None:
    """The search can fail: a dataset that was not pseudonymised is full of them."""
    ingest([named], tmp_path / "plain")
    found = set().union(*leaking(tmp_path / "plain").values())
    assert {"Anna", "Muster", "Kowalski", "track-4711", "2025-10-09", "20251009", "a time in t_s"} <= found


@pytest.mark.parametrize("words", [("inspect", "."), ("trace", ".", "--execution", "1", "--at", "2"), ("levels", ".")])
def test_no_json_output_tells_them(
    words: tuple[str, ...], made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made / "dataset")
    capsys.readouterr()
    assert run([*words, "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)
    assert not found_in(said.out + said.err)


def test_what_ingest_says_of_it_tells_no_name_either(
    named: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["ingest", str(named), "--out", str(tmp_path / "d"), "--pseudonymise", "--json", "--quiet"]
    for _ in range(2):  # the second time nothing is read
        assert run(words) == 0
        said = capsys.readouterr()
        assert not found_in(said.out + said.err)
        assert [file["path"] for file in json.loads(said.out)["not_read"]] == ["not_read_1"]


def test_samples_are_the_same_and_recordings_keep_their_relation(named: Path, made: Path, tmp_path: Path) -> None:
    plain = Dataset.open(ingest([named], tmp_path / "plain").dataset)
    hidden = Dataset.open(made / "dataset")
    there, here = plain.samples().drop("execution"), hidden.samples().drop("execution")
    for name, dtype in there.schema.items():
        if dtype.is_float():
            assert np.allclose(here[name].fill_null(-9), there[name].fill_null(-9), atol=1e-5), name
    offsets = {entry.adapter: entry.clock.offset_s for entry in hidden.recordings}
    assert offsets["ur-rtde"] == 0.0
    assert offsets["csv"] == pytest.approx(0.0, abs=1e-6)
    for entry in hidden.recordings:
        for table in entry.tables:
            recorded = hidden.recorded(entry.id, table)
            assert recorded is not None
            assert recorded["t_s"].min() == 0.0


def one_table(folder: Path, name: str, times: list[float]) -> Path:
    folder.mkdir(exist_ok=True)
    x = [0.3 * (int(number / 20) % 2) for number in range(len(times))]
    pl.DataFrame({"t": times, "x": x, "y": [0.0] * len(x)}).write_csv(folder / name)
    return folder


MAP = 'adapter = "csv"\nmap = { time = "t", x = "x", y = "y" }\n'


def test_a_clock_that_was_set_while_it_recorded_is_refused_since_its_step_tells_the_date(tmp_path: Path) -> None:
    times = [0.05 * row + (EPOCH_S if row >= 200 else 0.0) for row in range(400)]
    logs = one_table(tmp_path / "logs", "robot.csv", times)
    (logs / "cell.toml").write_text(f'[[sources]]\npath = "robot.csv"\nrole = "robot"\n{MAP}', encoding="utf-8")
    with pytest.raises(LogError, match="more than a year apart"):
        ingest([logs], tmp_path / "hidden", pseudonymise=True)
    assert not (tmp_path / "hidden").exists()


def test_two_clocks_of_which_one_was_not_set_are_refused(tmp_path: Path) -> None:
    logs = one_table(tmp_path / "logs", "robot.csv", [0.05 * row for row in range(400)])
    one_table(logs, "people.csv", [EPOCH_S + 0.05 * row for row in range(400)])
    (logs / "cell.toml").write_text(
        f'[[sources]]\npath = "robot.csv"\nrole = "robot"\n{MAP}'
        f'[[sources]]\npath = "people.csv"\nrole = "people"\nclock_offset_s = 0.0\n{MAP}',
        encoding="utf-8",
    )
    with pytest.raises(ConfigError, match="one of their clocks was not set"):
        ingest([logs], tmp_path / "hidden", pseudonymise=True)


def test_a_fleet_forgets_the_days_of_before(named: Path, tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(
        f"[fleet]\npseudonymise = true\n[[cell]]\nname = 'one'\nsources = ['{named.as_posix()}']\n", encoding="utf-8"
    )
    (cell,) = load_fleet(tmp_path / "fleet.toml").cells
    ledger = Path(cell.folder) / "cell.json"
    ledger.parent.mkdir(parents=True)
    ledger.write_text(json.dumps({"days": {"2025-10-09_Anna_Muster": "2025-10-09"}}), encoding="utf-8")
    run_stages(cell, stages=["ingest"])
    assert not leaking(Path(cell.folder))


PEOPLE = (
    "Anna Muster", "anna.muster", "MUSTER", "Muster, Anna", "A. Muster", "amuster", "AnnaMuster", "muster_a",
    "Jürgen Groß", "JÜRGEN GROSS", "groß", "Kowalski-Ring", "PC-MUSTER01", "FIRMA\\amuster", "anna.muster@firma.de",
    "Qiu", "Łukasz", "Юрий", "O'Kowalski", "musterAnna",
)  # fmt: skip
DATES = (
    "Mon Mar  2 2026", "02.03.26 14:03", "KW10 2026", "KW 10/26", "2026-W10", "2. März 2026", "2 March 2026",
    "Mar 2, 2026", "2026-03-02", "20260302_1403", "02.03.2026", "3/2/26", "3/2/2026", "Montag, 2. März", "March 2026",
    "03/2026", "14:03", "week 10", "1772460180", "2026-03-02T14:03:00+01:00",
)  # fmt: skip
PLANTED = (
    "anna", "muster", "jürgen", "groß", "gross", "kowalski", "firma", "qiu", "łukasz", "юрий", "mär", "mar ", "march",
    "montag", "kw10", "kw 10", "2026", "02.03", "3/2", "14:03", "17724", "week 10", "w10",
)  # fmt: skip


DIGEST = re.compile(r"\b[0-9a-f]{64}\b")
"""A checksum, some with a random key: about one in two hundred ingests has a year in one of them by chance."""


def planted_in(text: str) -> set[str]:
    return {word for word in PLANTED if word in DIGEST.sub("", text.lower())}


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Free text with every form of a name and a date: outcomes, tasks, agents, signals, values, in three formats."""
    folder = tmp_path_factory.mktemp("told") / "logs"
    folder.mkdir()
    tasks, events = ["run;agent;task;start_s;end_s;outcome"], ["time_s;signal;value"]
    xes, garbled = "", [f"{PEOPLE[0]} was here {DATES[0]}", f"9;{PEOPLE[2]};{DATES[1]};x;y;z"]
    for n, (person, date) in enumerate(zip(PEOPLE, DATES, strict=True)):
        agent = "worker_Anna Muster" if n % 2 else "ur5"
        tasks += [f"{n};{agent};pick by {person} {n};{2 * n};{2 * n + 1};ok by {person} on HOST at {date}"]
        events += [f"{n};door {n};opened {date} by {person}", f"{n};{person} light;{n}"]
        key = '<string key="{}" value="{}"/>'
        what = key.format("concept:name", f"weld {person} {date}") + key.format("org:resource", person)
        when = f'<date key="time:timestamp" value="2026-03-02T14:03:{n:02d}Z"/>'
        xes += "".join(
            f"<event>{what}{key.format('lifecycle:transition', one)}{when}</event>" for one in ("start", "complete")
        )
    (folder / "plan.csv").write_text("\n".join([*tasks, *garbled, ""]), encoding="utf-8")
    (folder / "events.csv").write_text("\n".join([*events, *garbled, ""]), encoding="utf-8")
    (folder / "mining.xes").write_text(f"<log><trace>{xes}</trace></log>", encoding="utf-8")
    return folder


def test_of_free_text_only_known_words_and_numbers_remain(
    told: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "d"
    assert run(["ingest", str(told), "--out", str(place), "--pseudonymise"]) == 0
    assert run(["inspect", str(place)]) == 0
    assert run(["inspect", str(place), "--json"]) == 0
    said = capsys.readouterr()
    texts = {"said": (said.out + said.err).replace("\\u2026", "…")}
    for file in place.rglob("*"):
        raw = file.read_bytes() if file.is_file() else b""
        texts[file.name] = f"{file.name} {raw.decode('utf-8', 'replace')} {raw.decode('latin-1')}"
        if file.suffix == ".parquet":
            table = pl.read_parquet(file)
            texts[f"{file.parent.name}/{file.name}"] = table.write_csv() + str(table.columns)
    found = {name: planted_in(text) for name, text in texts.items() if not name.endswith(".parquet") or "/" in name}
    assert not {name: words for name, words in found.items() if words}
    dataset = Dataset.open(place)
    listed = next(one for entry in dataset.recordings if (one := dataset.recorded(entry.id, "task_list")) is not None)
    assert listed["task"].n_unique() == len(PEOPLE)  # what was two stays two
    for kept in (
        "done",
        "failed",
        "TRUE",
        "false",
        "On",
        "off",
        "ein",
        "AUS",
        "frei",
        "belegt",
        "open",
        "closed",
        "high",
    ):
        assert Words().hidden(kept) == kept
    assert all(re.match(r"(pick by|weld) ", task) for task in listed["task"])


def test_words_that_the_cell_file_names_remain(told: Path, tmp_path: Path) -> None:
    cell = Cell(known_words=("Kowalski-Ring",), operator_signals=(OperatorSignal("Groß", "Łukasz light"),))
    words = Words.of(cell)
    assert words.hidden("pick Kowalski ring for GROSS Groß Łukasz Anna").startswith("pick Kowalski ring for word_")
    assert " Groß Łukasz word_" in words.hidden("pick Kowalski ring for GROSS Groß Łukasz Anna")
    assert words.hidden("Kowalski", {"Kowalski": "person_1"}) == "person_1"
    assert words.hidden("Tür X9") == words.hidden("Tür X9") != Words().hidden("weld Xaver")
    assert {Words().hidden("Xaver"), Words().hidden("Xaver")} != {words.hidden("Xaver")}


FORMS = ("%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d %H:%M:%S.%f", "%Y%m%d_%H%M%S", "%d.%m.%Y", "%m/%d/%Y", "%Y_%m_%d", "%H:%M:%S")


@given(
    st.datetimes(dt.datetime(1999, 1, 1), dt.datetime(2099, 1, 1)),
    st.sampled_from(FORMS),
    st.sampled_from(["", "at ", "log-", "(", "begin="]),
)
def test_no_date_is_left_in_a_text(when: dt.datetime, form: str, before: str) -> None:
    told = when.strftime(form)
    assert without_times(f"{before}{told} end") == f"{before}… end"


@given(st.floats(9.1e8, 4.1e9), st.sampled_from([0, 3, 6, 9]))
def test_no_number_since_1970_is_left_in_a_text(seconds: float, power: int) -> None:
    for told in (f"{seconds * 10**power:.0f}", f"{seconds * 10**power:.3f}", f"{seconds * 10**power:,.1f}"):
        assert without_times(f"row 12 of 4000, {told} s") == "row 12 of 4000, … s"


@given(st.floats(-1e8, 1e8))
def test_other_numbers_stay_to_the_last_digit(value: float) -> None:
    assert without_times(f"{value!r} m") == f"{value!r} m"
    assert re.search("m", without_times("4294967295 m"))

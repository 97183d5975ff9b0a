"""CODESYS Trace: three files of one recording, and what may be wrong with each."""

import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.codesys_trace import ADAPTER

SAMPLES = {
    "PLC_PRG.field": [(2, "FALSE"), (12, "FALSE"), (22, "TRUE")],
    "PLC_PRG.step": [(2, "10"), (12, "20"), (22, "20")],
    "PLC_PRG.speed": [(2, "30"), (12, "30.020000457763672"), (22, "30.1")],
}
EVENTS = [
    (0.002, "PLC_PRG.field", "FALSE"),
    (0.002, "PLC_PRG.step", "10"),
    (0.012, "PLC_PRG.step", "20"),
    (0.022, "PLC_PRG.field", "TRUE"),
]


def csv(samples=SAMPLES, flags="16"):
    lines = ["[key]; [value]", "Version; 0x03050000", "Name; Application.Trace", "Comment; ", f"Flags; {flags}"]
    for number, (name, rows) in enumerate(samples.items()):
        lines += [
            f"{number}.Variable; {name}",
            f"{number}.Class; 14",
            f"{number}.Data; ",
            *(f"; {t}; {v}" for t, v in rows),
        ]
    return "\n".join(lines) + "\n"


def trace(samples=SAMPLES, micro="False"):
    lists = [(name, *(",".join(str(row[k]) for row in rows) for k in (1, 0))) for name, rows in samples.items()]
    told = "".join(
        f'<TraceVariable VarName="{name}" Type="System.Double">'
        f"<Values>{values}</Values><Timestamps>{times}</Timestamps></TraceVariable>"
        for name, values, times in lists
    )
    unit = f'<Single Name="MicroSeconds" Type="bool">{micro}</Single>' if micro else ""
    config, data = f"<TraceConfiguration>{unit}</TraceConfiguration>", f"<TraceRecord>{told}</TraceRecord>"
    return f"<Trace>{config}<TraceData>{data}</TraceData></Trace>"


def text(samples=SAMPLES, unit="ms"):
    rows = zip(*(rows for rows in samples.values()), strict=True)
    lines = [f"Zeitstempel({unit}) " + " ".join(samples)]
    lines += [f"{row[0][0]} " + " ".join(value for _, value in row) for row in rows]
    return "CODESYS V3.5 SP20 Trace: Trace\nC:\\Trace\\Sample.project\n" + "\n".join(lines) + "\n"


def read(path, written, encoding="utf-8", **options):
    path.write_bytes(written.encode(encoding))
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["codesys-trace"]
    return ADAPTER.read(path, ReadOptions(**options))


@pytest.mark.parametrize("written", [csv(), trace(), text()])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_states_and_whole_numbers_are_signals_and_real_numbers_are_left_out(tmp_path, written, encoding):
    log = read(tmp_path / "a.trace", written, encoding)
    assert log.events.select("t_s", "signal", "value").rows() == EVENTS
    assert log.clock == "relative"
    assert any("left out" in said and "PLC_PRG.speed" in said for said in log.warnings)


@pytest.mark.parametrize("written", [csv(flags="32"), trace(micro="True"), text(unit="us")])
def test_the_file_says_where_its_times_are_microseconds(tmp_path, written):
    log = read(tmp_path / "a.trace", written)
    assert log.events["t_s"].to_list() == pytest.approx([t_s * 1e-3 for t_s, _, _ in EVENTS])


@pytest.mark.parametrize("written", [csv(flags="0"), trace(micro="")])
def test_a_trace_that_does_not_say_the_unit_is_refused_until_the_cell_file_does(tmp_path, written):
    with pytest.raises(LogError, match="milliseconds or microseconds") as refusal:
        read(tmp_path / "a.trace", written)
    assert "time_unit" in refusal.value.cure
    assert read(tmp_path / "a.trace", written, map={"time_unit": "ms"}).events["t_s"][0] == 0.002


def test_what_is_no_sample_is_set_aside_with_its_line(tmp_path):
    log = read(tmp_path / "a.csv", csv().replace("; 12; 20\n", "; 1x; 20\n") + "; 40; 2")
    assert log.set_aside.rows() == [
        (16, "neither a setting nor a sample: '; 1x; 20'"),
        (24, "the file ends in this line: it was cut while being written"),
    ]


def test_a_cut_document_gives_what_stands_before_the_cut(tmp_path):
    whole = trace()
    log = read(tmp_path / "a.trace", whole[: whole.index('<TraceVariable VarName="PLC_PRG.speed')])
    assert log.events.select("t_s", "signal", "value").rows() == EVENTS
    assert any("cut or garbled" in said for said in log.warnings)


def test_a_document_that_may_define_entities_is_refused(tmp_path):
    with pytest.raises(DamagedLog, match="document type"):
        read(tmp_path / "a.trace", trace().replace("<Trace>", '<!DOCTYPE t [<!ENTITY a "b">]><Trace>', 1))


def test_a_variable_with_more_times_than_values_is_left_out_and_said(tmp_path):
    log = read(tmp_path / "a.trace", trace().replace("FALSE,FALSE,TRUE", "FALSE,TRUE"))
    assert set(log.events["signal"]) == {"PLC_PRG.step"}
    assert any("3 times and 2 values" in said for said in log.warnings)


def test_a_trace_of_measured_values_alone_is_refused(tmp_path):
    with pytest.raises(DamagedLog, match="none is a signal"):
        read(tmp_path / "a.csv", csv({"v": [(1, "0.5")]}))
    with pytest.raises(DamagedLog, match="no sample"):
        read(tmp_path / "a.csv", csv({"v": []}))


@pytest.mark.parametrize("written", [csv(), trace(), text()])
def test_a_damaged_trace_gives_what_is_whole(tmp_path, written):
    read_damaged(ADAPTER, tmp_path / "a.trace", written.encode(), seed=10)


@given(
    st.lists(
        st.tuples(st.integers(0, 10**6), st.sampled_from(["TRUE", "FALSE", "0", "1", "7"])), min_size=1, max_size=30
    )
)
def test_csv_and_document_of_one_recording_are_read_alike(tmp_path_factory, rows):
    folder = tmp_path_factory.mktemp("trace")
    samples = {"a": sorted(rows)}
    logs = []
    for name, written in (("a.csv", csv(samples)), ("a.trace", trace(samples))):
        (folder / name).write_text(written)
        log = read_or_refuse(ADAPTER, folder / name)
        logs.append(log.events.select("t_s", "signal", "value").rows())
    assert logs[0] == logs[1]

import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import LogError
from cyclekit.ingest.registry import adapters
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.pedestrian import ADAPTER

PLAIN = "0 1 1.5 2.5\n0 2 4.0 5.0\n10 1 1.75 2.5\n10 2 4.0 5.25\n"
PETRACK = (
    "# PeTrack project: cell.pet\n# framerate: 25 fps\n# id frame x/m y/m z/m\n"
    "1 0 13.7271 1.028 1.58\n1 1 13.7288 1.0285 1.58\n2 1 4.0 5.0 1.7\n"
)
JUPEDSIM = "#framerate: 16\n#X,Y,Z: the agents coordinates in meters\n#ID\tFR\tX\tY\tZ\n1\t0\t8.21\t131.57\t0.00\n"

PEDPY = "# description: corridor\n# framerate: 25.00\n#geometry: geometry.xml\n\n# PersID\tFrame\tX\tY\tZ\n"
PEDPY += "1\t98\t4.6012\t1.8909\t1.7600\n1\t99\t4.5359\t1.8976\t1.7600\n"


def read(path, text, **options):
    path.write_text(text)
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["pedestrian"]
    return ADAPTER.read(path, ReadOptions(**options))


def test_frames_become_seconds_by_the_rate_that_was_given(tmp_path):
    log = read(tmp_path / "crowd.txt", PLAIN, rate_hz=25.0)
    assert log.people.rows() == [
        (0.0, "1", 1.5, 2.5, None, 1),
        (0.0, "2", 4.0, 5.0, None, 2),
        (0.4, "1", 1.75, 2.5, None, 3),
        (0.4, "2", 4.0, 5.25, None, 4),
    ]
    assert (log.up, log.clock) == ("z", "relative")
    assert any("no names" in said for said in log.warnings)


@pytest.mark.parametrize(
    "corrupt", ["151 3 1.5 2.5 7", "151 3", "151 3 1.5 x7", "15x 3 1.5 2.5", "1e99 3 1.5 2.5", "150 1 1.5 2.5"]
)
@pytest.mark.parametrize("line", [2, 151, 900])
def test_one_corrupt_line_among_many_is_set_aside_and_the_table_known(tmp_path, corrupt: str, line: int):
    rows = [f"{k} {1 + k % 2} {1 + 0.01 * k:.2f} 2.5" for k in range(1, 1000)]
    rows[line - 1] = corrupt
    log = examined(read(tmp_path / "crowd.txt", "\n".join([*rows, ""]), rate_hz=25.0))
    assert log.people.height == 998
    assert log.set_aside.height == 1


def test_a_rate_is_never_invented(tmp_path):
    with pytest.raises(LogError, match="states no rate") as refusal:
        read(tmp_path / "crowd.txt", PLAIN)
    assert "rate_hz" in refusal.value.cure


@pytest.mark.parametrize("mark", ["\t", ",", ";", "   "])
def test_any_delimiter_is_found_from_the_first_row(tmp_path, mark):
    log = read(tmp_path / "crowd.txt", PLAIN.replace(" ", mark), rate_hz=25.0)
    assert log.people["x_m"].to_list() == [1.5, 4.0, 1.75, 4.0]


def test_numbers_in_scientific_notation_are_ids_and_frames_all_the_same(tmp_path):
    text = "   7.8000000e+02   1.0000000e+00   8.4568443e+00   3.5\n   7.9500000e+02   1.0000000e+00   9.0   3.5\n"
    log = read(tmp_path / "crowd.txt", text, rate_hz=15.0)
    assert log.people.select("t_s", "person", "x_m").rows() == [(52.0, "1", 8.4568443), (53.0, "1", 9.0)]


def test_a_petrack_export_says_its_rate_columns_and_unit_in_comments(tmp_path):
    log = read(tmp_path / "crowd.txt", PETRACK)
    assert log.people.select("t_s", "person", "x_m", "z_m").rows() == [
        (0.0, "1", 13.7271, 1.58),
        (0.04, "1", 13.7288, 1.58),
        (0.04, "2", 4.0, 1.7),
    ]
    assert log.facts["rate_hz"] == "25, from the header"
    assert log.warnings == ()
    centimetres = read(tmp_path / "crowd.txt", PETRACK.replace("/m", "/cm"))
    assert centimetres.people["x_m"][0] == pytest.approx(0.137271)


def test_a_jupedsim_export_says_its_columns_in_a_comment(tmp_path):
    log = read(tmp_path / "crowd.txt", JUPEDSIM)
    assert log.people.select("person", "x_m", "y_m", "z_m").rows() == [("1", 8.21, 131.57, 0.0)]
    assert log.facts["unit"] == "m, from the header"


@pytest.mark.parametrize("head", ["frame,id,x,y", "Frame_ID,ped_id,pos_x,pos_y", "frame_id,track_id,x [m],y [m]"])
def test_a_header_of_names_says_which_column_is_which(tmp_path, head):
    text = f"{head}\n3,a,1.5,2.5\n".replace(" [", "[")
    log = read(tmp_path / "crowd.csv", text, rate_hz=10.0)
    assert log.people.rows() == [(pytest.approx(0.3), "a", 1.5, 2.5, None, 2)]


def test_nameless_columns_in_the_other_order_are_seen_or_said(tmp_path):
    doubled = "1 0 1.5 2.5\n1 0 1.6 2.5\n"
    path = tmp_path / "crowd.txt"
    path.write_text(doubled)
    with pytest.raises(LogError, match="an id occurs twice in a frame"):
        ADAPTER.read(path, ReadOptions(rate_hz=1.0))
    other = read(path, "7 0 1.5 2.5\n7 1 1.6 2.5\n", rate_hz=2.0, map={"columns": "id frame x y"})
    assert other.people.select("t_s", "person").rows() == [(0.0, "7"), (0.5, "7")]


def test_places_too_far_apart_for_metres_are_named(tmp_path):
    log = read(tmp_path / "crowd.txt", PLAIN.replace("4.0", "1400.5"), rate_hz=25.0)
    assert any("reach 1400 m" in said for said in log.warnings)
    log = read(tmp_path / "crowd.txt", PLAIN.replace("4.0", "1400.5"), rate_hz=25.0, map={"unit": "cm"})
    assert log.people["x_m"][1] == pytest.approx(14.005)


@pytest.mark.parametrize(
    "other",
    [
        "0.008 0.1 0.2 0.3\n0.016 0.1 0.2 0.3\n",
        "1 2 3 4\n5 6 7 8\n",
        "a b c d\n",
        "time,frame,id,x,y\n0,1,2,3,4\n",
        "Timestamp,id,x,y\n" + "".join(f"{k},1,{k / 100},2.5\n" for k in range(100)),
        "",
        "#\n",
    ],
)
def test_other_tables_are_not_recognised(tmp_path, other):
    path = tmp_path / "a.txt"
    path.write_text(other)
    assert not ADAPTER.recognises(path)


def test_a_line_of_a_hundred_thousand_names_is_turned_down_at_once(tmp_path):
    path = tmp_path / "wide.txt"
    path.write_text("a," * 500_000 + "\n1\n")
    with pytest.raises(LogError, match="not a table"):
        ADAPTER.read(path, ReadOptions(rate_hz=1.0))


def test_a_last_row_cut_while_being_written_is_set_aside(tmp_path):
    log = read(tmp_path / "crowd.txt", PLAIN[:-2], rate_hz=25.0)
    assert log.people.height == 3
    assert log.set_aside["source_row"].to_list() == [4]


@pytest.mark.parametrize("text", [PLAIN, PETRACK, PEDPY])
def test_damage_gives_what_is_whole_or_a_refusal(tmp_path, text):
    path = tmp_path / "crowd.txt"
    read_damaged(ADAPTER, path, text.encode(), seed=8, options=ReadOptions(rate_hz=25.0))


_LINE = st.sampled_from(
    [*PLAIN.splitlines(), *PETRACK.splitlines(), *JUPEDSIM.splitlines(), *PEDPY.splitlines(), "frame,id,x,y", ""]
)


@pytest.mark.parametrize(
    ("head", "row", "place"),
    [
        ("# PersID Frame X Y Z", "7 50 1.5 2.5 1.7", (1.5, 2.5, 1.7)),
        ("# PersID Frame X Y", "7 50 1.5 2.5", (1.5, 2.5, None)),
        ("PersID,Frame,X,Y,Z", "7,50,1.5,2.5,1.7", (1.5, 2.5, 1.7)),
        ("# PersID Frame X/cm Y/cm Z/cm", "7 50 150 250 170", (1.5, 2.5, 1.7)),
        ("#ID FR X Y Z A B ANGLE COLOR", "7 50 1.5 2.5 0 .3 .2 10 99", (1.5, 2.5, 0.0)),
    ],
)
def test_headers_of_jupedsim_and_pedpy_say_which_number_is_whose(tmp_path, head, row, place):
    log = read(tmp_path / "crowd.txt", f"# framerate: 25 fps\n{head}\n{row}\n")
    assert log.people.rows() == [(2.0, "7", *place, 3)]


def test_a_table_of_pedpy_is_read_by_its_comments(tmp_path):
    log = read(tmp_path / "crowd.txt", PEDPY)
    assert log.people.rows() == [(3.92, "1", 4.6012, 1.8909, 1.76, 6), (3.96, "1", 4.5359, 1.8976, 1.76, 7)]
    assert log.facts["rate_hz"] == "25, from the header"


def test_a_rate_that_the_comments_lack_is_asked_for(tmp_path):
    with pytest.raises(LogError, match="states no rate") as refusal:
        read(tmp_path / "crowd.txt", PEDPY.replace("framerate", "made"))
    assert "rate_hz" in refusal.value.cure
    log = read(tmp_path / "crowd.txt", PEDPY.replace("framerate", "made"), rate_hz=10.0)
    assert log.people["t_s"].to_list() == pytest.approx([9.8, 9.9])


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("1 28 164.8 780.8 168.9\n1 29 164.9 771.9 168.9\n", "169 m above the floor"),
        ("1 28 164.8 780.8 0\n1 29 164.9 775.8 0\n", "at 125 m/s"),
    ],
)
def test_centimetres_that_are_not_stated_are_asked_for_not_taken_as_metres(tmp_path, rows, said):
    text = f"# framerate: 25\n# PersID Frame X Y Z\n{rows}"
    with pytest.raises(LogError, match=said) as refusal:
        read(tmp_path / "crowd.txt", text)
    assert 'unit = "cm"' in refusal.value.cure
    assert read(tmp_path / "crowd.txt", text, map={"unit": "cm"}).people["x_m"][0] == pytest.approx(1.648)


def test_rows_of_pedpy_that_lack_a_column_are_set_aside_with_their_line(tmp_path):
    log = read(tmp_path / "crowd.txt", PEDPY + "1\t100\t4.4470\n1\t101\t4.4\t1.9\t1.76\n")
    assert log.people["source_row"].to_list() == [6, 7, 9]
    assert log.set_aside["source_row"].to_list() == [8]


@given(lines=st.lists(_LINE | st.text(alphabet=" \t,019.-e#frameidxy/m", max_size=12), max_size=12))
def test_any_order_of_lines_is_read_or_refused(tmp_path_factory, lines):
    path = tmp_path_factory.getbasetemp() / "any_crowd.txt"
    path.write_text("\n".join(lines) + "\n")
    read_or_refuse(ADAPTER, path, ReadOptions(rate_hz=25.0))


def walkers(order):
    """Return two people who walk 5 cm a frame, 3 m apart, as `id frame x y` or `frame id x y`."""
    rows = [(who, frame, 0.05 * frame + 0.5, 3.0 * who + 0.5) for who in (1, 2) for frame in range(10)]
    rows = rows if order == "id frame" else sorted((b, a, x, y) for a, b, x, y in rows)
    return "".join(f"{a} {b} {x:.2f} {y:.2f}\n" for a, b, x, y in rows)


def test_nameless_columns_that_are_rather_id_and_frame_are_refused_until_that_is_said(tmp_path):
    path = tmp_path / "crowd.txt"
    log = read(path, walkers("frame id"), rate_hz=10.0)
    assert log.people.filter(log.people["person"] == "2")["y_m"].to_list() == [6.5] * 10
    with pytest.raises(LogError, match="probably id, frame") as refusal:
        read(path, walkers("id frame"), rate_hz=10.0)
    assert 'columns = "id frame x y"' in refusal.value.cure
    said = read(path, walkers("id frame"), rate_hz=10.0, map={"columns": "id frame x y"})
    assert (
        said.people.sort("t_s", "person", maintain_order=True)
        .drop("source_row")
        .equals(log.people.sort("t_s", "person").drop("source_row"))
    )


def test_five_nameless_columns_are_read_where_the_cell_file_names_adapter_and_columns(tmp_path):
    path = tmp_path / "crowd.txt"
    path.write_text("1 28 -37.8 264.1 172.3\n1 29 -37.5 263.9 172.3\n")
    assert not ADAPTER.recognises(path)
    options = ReadOptions(rate_hz=25.0, map={"columns": "id frame x y z", "unit": "cm"})
    people = ADAPTER.read(path, options).people
    assert people.rows()[0] == (1.12, "1", pytest.approx(-0.378), pytest.approx(2.641), pytest.approx(1.723), 1)
    with pytest.raises(LogError, match="not a table"):
        ADAPTER.read(path, ReadOptions(rate_hz=25.0))

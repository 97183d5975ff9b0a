"""Several executions, zones, other people, skeletons, errors of the model, and the server: read back for real."""

from __future__ import annotations

import json
import shutil
import socket
import threading
import time
import urllib.request

import browser
import numpy as np
import polars as pl
import pytest
from fabricated import THRESHOLDS_M, fabricate_dataset
from rerun.chunk import RrdReader
from ruled import box, ruled

from cyclekit import schema
from cyclekit.alignment.clocks import ClockStart, fit_clock
from cyclekit.dataset.cards import plain
from cyclekit.dataset.dataset import CARD, Dataset
from cyclekit.errors import CyclekitError
from cyclekit.replay import serve, write_replay
from cyclekit.replay.compare import comparison, most_different
from cyclekit.replay.execution import load_execution
from cyclekit.replay.phase import TASK, common_order, path_phase
from cyclekit.replay.prediction_errors import prediction_errors
from cyclekit.replay.time_accounting import time_accounting
from cyclekit.storage.atomic import write_parquet


class Staircase:
    """The true staircase as a model of problem `now`; wrong for an operator at x > `wrong_from_m`."""

    problem = "now"

    def __init__(self, wrong_from_m=np.inf):
        self.wrong_from_m = wrong_from_m

    def predict(self, x):
        distance = np.linalg.norm(x[:, :3] - x[:, 3:], axis=1)
        right = np.searchsorted(np.array(THRESHOLDS_M), distance, side="right") / 4
        return np.where(x[:, 3] > self.wrong_from_m, 0.0, right)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return fabricate_dataset(tmp_path_factory.mktemp("cell") / "dataset", executions=2, rounds=2)


def rows_of(rrd, name, by="execution"):
    batches = [c.to_record_batch() for c in RrdReader(rrd).stream() if str(c.entity_path) == name and not c.is_static]
    return pl.concat([pl.DataFrame(batch) for batch in batches]).sort(by) if batches else None


def entities(rrd):
    return {str(chunk.entity_path) for chunk in RrdReader(rrd).stream()}


def copied(dataset, path):
    shutil.copytree(dataset.path, path)
    return path


def test_two_executions_lie_side_by_side_each_with_its_scene_and_its_curves(dataset, tmp_path):
    facts = write_replay(dataset, ["1", "2"], tmp_path / "x.rrd")
    assert len(facts.executions) == 2
    found = entities(facts.path)
    for number, name in enumerate(facts.executions, start=1):
        assert f"/{number}/scene/robot/tool" in found
        shown = rows_of(facts.path, f"/{number}/plots/scaling/logged")["Scalars:scalars"].explode()
        assert shown.to_list() == dataset.samples([name]).sort("t_s")["scaling"].to_list()
    assert "/comparison" in found


def test_more_executions_than_can_be_told_apart_are_refused(tmp_path):
    cell = fabricate_dataset(tmp_path / "d", executions=5, rounds=1)
    with pytest.raises(CyclekitError, match="5 executions side by side"):
        write_replay(cell, ["1", "2", "3", "4", "5"], tmp_path / "x.rrd")


def test_at_the_same_phase_both_robots_are_at_the_same_place(dataset, tmp_path):
    facts = write_replay(dataset, ["1", "2"], tmp_path / "x.rrd")
    places = []
    for number in (1, 2):
        tool = rows_of(facts.path, f"/{number}/scene/robot/tool", by="path_phase")
        first = tool.group_by("path_phase").first()
        places.append({row["path_phase"]: row["Points3D:positions"][0] for row in first.iter_rows(named=True)})
    common = sorted(set(places[0]) & set(places[1]))
    assert len(common) > 100
    apart = [np.linalg.norm(np.subtract(places[0][phase], places[1][phase])) for phase in common]
    assert max(apart) < 0.06  # a sample of 0.1 s at 0.5 m/s, where seconds of the execution would be a metre off


def test_a_task_done_in_another_order_still_has_its_phase(dataset):
    one, two = (load_execution(dataset, name) for name in ("1", "2"))
    swapped = two.tasks.with_columns(index=pl.col("index").reverse())
    order = common_order([one, two])
    phase = path_phase(two, order)
    third = two.tasks.row(2, named=True)
    inside = (two.t_s > third["start_s"] + 0.2) & (two.t_s < third["arrival_s"] - 0.2)
    assert set((phase[inside] // TASK).tolist()) == {order[third["task"], 1]}
    assert swapped.height == one.tasks.height
    assert (np.diff(phase) >= 0).all()


def test_the_comparison_names_the_quicker_one_and_the_task_that_differs_most(dataset):
    runs = [load_execution(dataset, name) for name in ("1", "2")]
    text = comparison(runs)
    quickest = min(runs, key=lambda run: run.duration_s)
    assert text.startswith(f"## {quickest.name} is the quickest")
    apart = {}
    for task in most_different(runs):
        took = [r.tasks.filter(pl.col("task") == task[0]).row(task[1] - 1, named=True) for r in runs]
        apart[task] = abs((took[0]["end_s"] - took[0]["start_s"]) - (took[1]["end_s"] - took[1]["start_s"]))
    assert list(apart.values()) == sorted(apart.values(), reverse=True)
    assert len(apart) == 8


def test_the_time_of_day_is_a_timeline_where_a_log_knows_it(dataset, tmp_path):
    path = copied(dataset, tmp_path / "dated")
    card = json.loads((path / CARD).read_text("utf-8"))
    began_s = 1_750_000_000.0
    for record in card["recordings"]:
        record["clock"] = {"kind": "epoch", "method": "own", "offset_s": -began_s, "rate": 1.0}
    (path / CARD).write_text(json.dumps(card), "utf-8")
    facts = write_replay(Dataset.open(path), "1", tmp_path / "x.rrd")
    shown = rows_of(facts.path, "/plots/scaling/logged")
    assert shown["wall_clock"][0].timestamp() == pytest.approx(began_s, abs=1e-3)
    assert "session" not in shown.columns


def test_a_clock_that_is_assumed_to_start_together_tells_no_time_of_day(dataset, tmp_path):
    path = copied(dataset, tmp_path / "undated")
    card = json.loads((path / CARD).read_text("utf-8"))
    fit = fit_clock(ClockStart("epoch", 1_750_000_000.0), ClockStart("relative", 0.0), None)
    for record in card["recordings"]:
        record["clock"] = plain(fit.card("epoch"))
    (path / CARD).write_text(json.dumps(card), "utf-8")
    assert load_execution(Dataset.open(path), "1").epoch_s is None


def test_the_accounts_of_time_add_up_to_the_tasks_and_to_the_whole(dataset):
    run = load_execution(dataset, "1")
    spent = time_accounting(run)
    assert sum(account[-1] for account in spent.values()) == pytest.approx(run.t_s[-1] - run.t_s[0])
    for name, column in (("nominal", "nominal_s"), ("safety", "safety_loss_s"), ("dwell", "dwell_s")):
        assert spent[name][-1] == pytest.approx(run.tasks[column].sum(), abs=0.6)
    assert all((np.diff(account) >= 0).all() for account in spent.values())


def test_a_model_that_is_right_has_no_errors_to_hunt_and_a_wrong_one_is_caught_where_it_is_wrong(dataset, tmp_path):
    assert prediction_errors(load_execution(dataset, "1", Staircase())) == []
    run = load_execution(dataset, "1", Staircase(wrong_from_m=1.3))
    found = prediction_errors(run)
    assert found
    for miss in found:
        row = int(np.searchsorted(run.t_s, miss.t_s))
        assert run.human_m[row, 0] > 1.3
        assert abs(miss.logged - miss.predicted) == pytest.approx(abs(run.scaling[row] - run.predicted[row]))
    assert [miss.seconds for miss in found] == sorted((miss.seconds for miss in found), reverse=True)
    facts = write_replay(dataset, "1", tmp_path / "x.rrd", model=Staircase(wrong_from_m=1.3), at="error")
    listed = rows_of(facts.path, "/misses")
    assert listed.height == len(facts.misses)
    worst = listed.filter(pl.col("TextLog:text").list.first().str.starts_with("#1:"))
    assert worst["execution"][0].total_seconds() == pytest.approx(facts.misses[0].t_s, abs=1e-5)


def test_the_floor_has_the_colour_of_the_speed_that_the_model_expects_there(dataset, tmp_path):
    run = load_execution(dataset, "1", Staircase())
    zones = run.zones
    row = int(np.searchsorted(run.t_s, zones.t_s[3]))
    height = np.nanmedian(run.human_m[:, 2])
    standing = np.column_stack([zones.centre_m, np.full(len(zones.centre_m), height)])
    distance = np.linalg.norm(standing - run.robot_m[row], axis=1)
    assert zones.scaling[3] == pytest.approx(np.searchsorted(THRESHOLDS_M, distance, side="right") / 4)
    seen = dataset.samples()["human_x_m", "human_y_m"].drop_nulls().to_numpy()
    nearest = np.abs(zones.centre_m[:, None] - seen[None]).max(axis=2).min(axis=1)
    assert nearest.max() <= 1.5 * 0.25 + 1e-9  # nothing is drawn where nobody ever was
    facts = write_replay(dataset, "1", tmp_path / "x.rrd", model=Staircase())
    shown = rows_of(facts.path, "/scene/zones")
    assert [len(colours) for colours in shown["Boxes3D:colors"]] == [len(zones.centre_m)] * len(zones.t_s)
    assert "/scene/zones" not in entities(write_replay(dataset, "1", tmp_path / "y.rrd").path)


def test_the_rules_rectangle_lies_on_the_floor_with_its_speed(dataset, tmp_path):
    facts = write_replay(dataset, "1", tmp_path / "x.rrd", model=ruled((0.5, box(0.8, 1.6, -0.5, 0.5), None)))
    (drawn,) = [
        chunk.to_record_batch() for chunk in RrdReader(facts.path).stream() if str(chunk.entity_path) == "/scene/rule"
    ]
    row = pl.DataFrame(drawn)
    ((line,),) = row["LineStrips3D:strips"].to_list()
    corners = [(0.8, -0.5), (1.6, -0.5), (1.6, 0.5), (0.8, 0.5), (0.8, -0.5)]
    np.testing.assert_allclose([point[:2] for point in line], corners, atol=1e-6)
    assert row["LineStrips3D:labels"].to_list() == [["50 %"]]
    assert "/scene/rule" not in entities(write_replay(dataset, "1", tmp_path / "y.rrd", model=Staircase()).path)


def second_person(path, offset_m):
    """Add somebody who walks `offset_m` beside the operator to the trackers' recordings."""
    for file in (path / "recordings").glob("*/people.parquet"):
        rows = pl.read_parquet(file)
        write_parquet(pl.concat([rows, rows.with_columns(pl.col("x_m") + offset_m, person=pl.lit("2"))]), file)
    card = json.loads((path / CARD).read_text("utf-8"))
    for record in card["recordings"]:
        if "people" in record["rows"]:
            record["rows"]["people"] *= 2
    (path / CARD).write_text(json.dumps(card), "utf-8")
    return Dataset.open(path)


def test_everybody_but_the_operator_is_drawn_as_somebody_else(dataset, tmp_path):
    facts = write_replay(second_person(copied(dataset, tmp_path / "two"), 1.5), "1", tmp_path / "x.rrd")
    others = rows_of(facts.path, "/scene/others/head")
    operator = rows_of(facts.path, "/scene/operator/head")
    pairs = list(zip(others["Points3D:positions"], operator["Points3D:positions"], strict=True))
    both = [(other[0], own[0]) for other, own in pairs if len(own)]
    assert len(both) > 100
    assert {len(other) for other, own in pairs if len(own)} == {1}
    apart = np.array([np.subtract(other, own) for other, own in both])
    assert apart[:, 0] == pytest.approx(np.full(len(apart), 1.5), abs=0.05)
    alone = write_replay(dataset, "1", tmp_path / "y.rrd")
    assert "/scene/others/head" not in entities(alone.path)


LIMBS = {"pelvis": 0.0, "spine": 0.3, "neck": 0.55, "head": 0.75, "knee": -0.45, "foot": -0.9}


def test_limbs_are_drawn_where_skeletons_were_kept_and_the_body_is_not(dataset, tmp_path):
    path = copied(dataset, tmp_path / "limbs")
    card = json.loads((path / CARD).read_text("utf-8"))
    for record in card["recordings"]:
        people = pl.read_parquet(path / "recordings" / record["id"] / "people.parquet")
        joints = [people.with_columns(pl.col("z_m") + up, joint=pl.lit(name)) for name, up in LIMBS.items()]
        frame = schema.conform(pl.concat(joints), schema.SKELETONS)
        write_parquet(frame, path / "recordings" / record["id"] / "skeletons.parquet")
        record["tables"].append("skeletons")
    (path / CARD).write_text(json.dumps(card), "utf-8")
    facts = write_replay(Dataset.open(path), "1", tmp_path / "x.rrd")
    limbs = rows_of(facts.path, "/scene/limbs")
    body = rows_of(facts.path, "/scene/operator/body")
    seen = [strips for strips in limbs["LineStrips3D:strips"] if len(strips)]
    assert {len(strips) for strips in seen} == {len(LIMBS) - 1}
    lengths = sorted(np.linalg.norm(np.subtract(*strip)) for strip in seen[0])
    assert lengths == pytest.approx(sorted([0.3, 0.25, 0.2, 0.45, 0.45]), abs=1e-3)  # joint to its neighbour
    assert body is None or not any(len(row) for row in body["Capsules3D:translations"])


def test_a_lane_ends_where_its_task_ends_and_says_where_the_log_has_a_hole(dataset, tmp_path):
    path = copied(dataset, tmp_path / "cut")
    for file in (path / "samples").glob("*.parquet"):
        write_parquet(pl.read_parquet(file).filter(~pl.col("t_s").is_between(4.0, 7.0)), file)
    facts = write_replay(Dataset.open(path), "1", tmp_path / "x.rrd")
    lane = rows_of(facts.path, "/lanes/1_robot_speed")
    states = [row[0] if len(row) else None for row in lane["StateChange:state"]]
    assert "gap in the log" in states
    assert states[-1] is None
    assert "None" not in states


@pytest.fixture
def served(dataset, tmp_path, monkeypatch):
    for variable in ("HOME", "XDG_CONFIG_HOME", "APPDATA"):  # the switch of the usage counting is a file there
        monkeypatch.setenv(variable, str(tmp_path))
    facts = write_replay(dataset, "1", tmp_path / "x.rrd")
    with serve(facts.path, port=0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server, facts.path
        server.shutdown()


def test_a_replay_is_served_to_this_machine_only_and_asks_nobody_else(served, tmp_path):
    server, replay = served
    with urllib.request.urlopen(server.address, timeout=20) as page:
        assert b"rerun" in page.read().lower()
        assert page.headers["Content-Security-Policy"].startswith("default-src 'self'")
        assert "http" not in page.headers["Content-Security-Policy"]
    with urllib.request.urlopen(server.address + "replay.rrd", timeout=20) as recording:
        assert recording.read() == replay.read_bytes()
    with socket.socket() as caller:  # who listens on all interfaces answers here
        assert caller.connect_ex(("127.0.0.2", server.server_address[1])) != 0
    (settings,) = tmp_path.rglob("analytics.json")
    assert json.loads(settings.read_text("utf-8"))["analytics_enabled"] is False


@pytest.mark.slow
@pytest.mark.skipif(browser.why_not() is not None, reason=str(browser.why_not()))
def test_the_served_viewer_gets_nothing_from_elsewhere(served):
    server, _ = served
    with browser.open_browser() as tab:
        tab.call("Page.navigate", url=server.address)
        until_s = time.monotonic() + 60
        while time.monotonic() < until_s and not any(url.endswith("/replay.rrd") for url in tab.requests()):
            tab.ask("new Promise(done => setTimeout(done, 200))")
        assert any(url.endswith("/replay.rrd") for url in tab.requests())
        answered = [e["params"]["response"]["url"] for e in tab.events if e.get("method") == "Network.responseReceived"]
        assert all(url.startswith((server.address, "data:", "blob:")) for url in answered)
        refused = {
            event["params"]["requestId"]: event["params"].get("blockedReason")
            for event in tab.events
            if event.get("method") == "Network.loadingFailed"
        }
        outside = [
            (event["params"]["request"]["url"], refused.get(event["params"]["requestId"]))
            for event in tab.events
            if event.get("method") == "Network.requestWillBeSent"
            and not event["params"]["request"]["url"].startswith((server.address, "data:", "blob:"))
        ]
        assert all(reason == "csp" for _, reason in outside), outside  # stopped before it left the browser


def test_a_port_that_is_taken_is_said(served):
    server, replay = served
    with pytest.raises(CyclekitError, match="cannot serve the replay"):
        serve(replay, port=server.server_address[1])

"""Notes: warnings for the user, each a code with values, and the one table of their sentences.

Code that finds a limit makes a `Note`; the sentence is made when it is shown. So no code searches sentences for words,
and sentences can be improved without changing behaviour.
"""

from __future__ import annotations

import string
from typing import TYPE_CHECKING

from msgspec import field

from cyclekit.dataset.cards.quantities import Card
from cyclekit.text.numbers import by_spec, compact, fixed, percent, signed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

Value = str | int | float
"""Type of a value in a note."""

TEXT = "text"
"""Code of a sentence in a dataset or model of an earlier version, which stored only sentences."""
READ = "read"
"""Code of a sentence about a log, from its adapter or from the check of its rows."""
IMPOSSIBLE = "impossible"
"""Code of such a sentence about a column that cannot be as it was read."""


class Note(Card, frozen=True, kw_only=False):
    """A warning for the user.

    Attributes:
        code: Key in `SENTENCES`.
        values: Values in the sentence, by name.
    """

    code: str
    values: dict[str, Value] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The sentence, with its advice."""
        return f"{self.finding}; {ADVICE[self.code]}" if self.code in ADVICE else self.finding

    @property
    def finding(self) -> str:
        """The sentence without its advice, which may have been followed already."""
        if (sentence := SENTENCES.get(self.code)) is not None:
            try:
                return sentence(self.values) if callable(sentence) else _FORMAT.vformat(sentence, (), self.values)
            except (KeyError, ValueError, TypeError):
                pass  # values of another version: shown without a sentence
        return f"{self.code} ({', '.join(f'{name} {value}' for name, value in self.values.items())})"


def note(code: str, **values: Value) -> Note:
    """Return a note."""
    return Note(code, values)


def texts(notes: Iterable[Note]) -> list[str]:
    """Return the sentence of each note."""
    return [one.text for one in notes]


def changed(one: Note, said: Callable[[str], str], number: Callable[[float], Value]) -> Note:
    """Return a note with its texts and numbers mapped by functions."""
    values = {name: said(value) if isinstance(value, str) else number(value) for name, value in one.values.items()}
    return Note(one.code, values)


def from_sentences(values: object) -> object:
    """Return notes in JSON form, with the sentences of earlier versions converted to notes."""
    if not isinstance(values, list):
        return values
    return [{"code": TEXT, "values": {"text": one}} if isinstance(one, str) else one for one in values]


class _Format(string.Formatter):
    """Formatter of values; a text stays unchanged in place of a number, as pseudonymising removes numbers."""

    def format_field(self, value: object, format_spec: str) -> str:
        return by_spec(value, format_spec) if format_spec and isinstance(value, int | float) else str(value)


_FORMAT = _Format()


def _scaling(values: Mapping[str, Value]) -> str:
    silent, runs = values["silent"], values["runs"]
    said = "no log holds a" if silent == runs else f"{silent} of {runs} runs hold no"
    return f"{said} valid speed scaling"


def _scaling_inferred(values: Mapping[str, Value]) -> str:
    count, alone = int(values["references"]), int(values["alone"])
    how = f"runs without the operator ({count} motions)"
    if alone == 0:
        how = f"the fastest repetitions ({count} motions)"
    elif alone < count:
        how = f"runs without the operator ({alone} motions) and the fastest repetitions ({count - alone} motions)"
    slowed = values["never_at_full_speed"]
    seen = f"; never at full speed, so unknown: {slowed}" if slowed else ""
    return f"{_scaling(values)}: inferred from velocity ratios against {how}{seen}"


def _overrides(values: Mapping[str, Value]) -> str:
    if values["logs"] == 1:
        return f"the override of {values['log']} is"
    return f"the overrides of {values['logs']} logs ({values['log']}, …) are"


def _override(values: Mapping[str, Value], conclusion: str) -> str:
    """Return what was seen of a set override, and what follows."""
    turns, hours, sliders = values["turns"], float(values["hours"]), values["sliders"]
    share = f", of which what else was logged explains {percent(float(values['share']))}" if "share" in values else ""
    hand = f", times a slider that a hand set ({sliders})" if sliders else ""
    return f"the set override (speed slider) changed {turns} times in {fixed(hours, 1)} h{share}: {conclusion}{hand}"


def _later(values: Mapping[str, Value]) -> str:
    first, last = (signed(float(values[name]), 2) for name in ("earliest_s", "latest_s"))
    return f"{first if first == last else f'{first} to {last}'} s after it was logged"


def _in_first_part(values: Mapping[str, Value]) -> str:
    more = f" and {values['others']} more" if values["others"] else ""
    return (
        f"{values['log']}{more}: used in the first part of {values['robot']} only, as nothing in the logs relates its "
        "clock to the later parts; give sync, or split it at the restart as well, one folder for each part"
    )


def _clock_apart(values: Mapping[str, Value]) -> str:
    cure = 'give clock_offset_s, or align_clocks = "logs", in cell.toml'
    if "offset_s" in values:
        role = 'role = "robot" and ' if "role" in values else ""
        offset = compact(float(values["offset_s"]), 10)
        cure = f"{values['cause']}? Then give {role}clock_offset_s = {offset} in cell.toml"
    outside = f"{percent(float(values['outside']))} of the shorter log lies outside the other"
    return f"hardly overlaps {values['robot']}: {outside}, and it is {values['late']}; {cure}"


def _clock_contradicted(values: Mapping[str, Value]) -> str:
    here = f", and {percent(float(values['here']))} as it is" if "here" in values else ""
    rate = f", clock_rate = {fixed(float(values['rate']), 6)}" if "rate" in values else ""
    within = f" (to within {fixed(float(values['error_s']), 2)} s)" if "error_s" in values else ""
    told, of, cure = "the place of people", "speed level", 'align_clocks = "logs"'
    if "signals" in values:
        told, of, cure = "its signals", "speed, motion and signals", "sync"
    if "other_s" in values:
        here, best, other = (percent(float(values[name])) for name in ("here", "explained", "next_best"))
        lag, other_lag = (signed(float(values[name]), 1) for name in ("lag_s", "other_s"))
        return (
            f"its clock is wrong: as it is, the place of people explains {here} of the robot's speed level, {lag} s "
            f"away {best}, but {other_lag} s away {other}: which is right is not certain; give clock_offset_s, sync or "
            "sees in cell.toml, or log longer"
        )
    return (
        f"its clock is wrong: {signed(float(values['lag_s']), 2)} s{within} would let {told} explain "
        f"{percent(float(values['explained']))} of the robot's {of} (next best "
        f"{percent(float(values['next_best']))}"
        f"{here}); give clock_offset_s = {fixed(float(values['offset_s']), 2)}{rate}, or {cure}, in cell.toml"
    )


UNPROVEN = "waits-unproven"
"""What was learned on who waits for whom is not used."""
ADVICE = dict.fromkeys(
    ("levels-none", "levels-many", "levels-wide", "scaling-continuous", "levels-not-held"),
    "learn it by regression: --network regressor",
) | {UNPROVEN: "give what ends the waits in [[waits]] of the cell file"}
"""Advice for training, by the code of its note."""

SENTENCES: dict[str, str | Callable[[Mapping[str, Value]], str]] = {
    TEXT: "{text}",
    READ: "{text}",
    IMPOSSIBLE: "{text}",
    "goal-signal-unknown": "goal_signals of the cell file: no log holds a signal {signal!r}",
    "log-changed": "the log changed while it was read: is it still being written? ingest again when it is complete",
    "log-copied": (
        "{copies} log(s) are copies of others ({copy} of {of}): their executions count twice; remove the copies and "
        "ingest again"
    ),
    "log-divided": (
        "{log}: its clock was restarted while recording: each of its {parts} parts is a session ({first} to {last})"
    ),
    "log-in-first-part": _in_first_part,
    "robots-at-once": (
        "{one} and {other} are robot logs of the same time: several robots are taken for one, and a person's effect on "
        "one for that on all; make a dataset of each, with the logs of the others under ignore in cell.toml"
    ),
    # clocks
    "clock-assumed": (
        "the offset of its clock to the robot's is unknown: a common start is assumed; "
        "give clock_offset_s, sync or sees in cell.toml"
    ),
    "clock-part-unknown": (
        "nothing in the logs relates its clock to this part of the robot's log, so nobody is seen in it; give sync, or "
        "split it at the restart as well, one folder for each part"
    ),
    "clock-apart": _clock_apart,
    "clock-unit": (
        "in {read}, as read, its times last {lasts} beside {robot_lasts} of {robot}; in {unit} they would last "
        '{would_last}: is time_unit = "{unit}"?'
    ),
    "clock-future": (
        "its last time is {late} than its file was written: its clock, its unit or its epoch is wrong; give "
        "clock_offset_s in cell.toml"
    ),
    "clock-restarted": (
        "a device's clock was restarted while recording, so its stamps cannot align the clock: split the log there"
    ),
    "clock-of-robot-restarted": (
        "the robot's clock was restarted while recording: this log is aligned with one part of the robot's log only, "
        "and its signals are wrong in the others; split the robot's log at the restart, and this log too"
    ),
    "clock-stamps-apart": (
        "a device's and its host's stamps drift apart by more than clocks do, and no linear fit describes them"
    ),
    "clock-stamps-late": (
        "its stamps are typically {late_s:.2g} s later than the line that aligns its clock: delays, or a poor fit"
    ),
    "clock-of-host-differs": (
        "its clock runs at {rate:.4f} times the speed of its host's, which no real clock does: if its time is "
        "simulated, durations are simulated ones"
    ),
    "clock-not-by-logs": (
        "not aligned by the logs: they show no lag for certain at which it explains what the robot does; give "
        "clock_offset_s or sync in cell.toml"
    ),
    "clock-by-logs": (
        "its clock was aligned by the logs, {lag_s:+.2f} s (to within {error_s:.2f} s): there the place of people "
        "explains {explained:.0%} of the robot's speed level, next best {next_best:.0%}; the reaction delay of the "
        "safety function is hidden in it"
    ),
    "clock-by-logs-unsure": (
        "its clock was aligned by the logs, {lag_s:+.2f} s, but that is NOT certain: the place of people explains "
        "{explained:.0%} of the robot's speed level there, and {next_best:.0%} at another lag, {away_s:+.1f} s away; "
        "give clock_offset_s, sync or sees in cell.toml, or log longer"
    ),
    "clock-contradicted": _clock_contradicted,
    "robot-clock-wrong": (
        "its clock is not that of {robot}: {lag_s:+.2f} s (to within {error_s:.2f} s) would let {by} agree; "
        'give role = "robot" and clock_offset_s = {offset_s:.2f} in cell.toml'
    ),
    "robot-clock-or-process": (
        "its signals tell best what {robot} does at {lag_s:+.2f} s, which may be the time that the process takes; "
        'if it is its clock, give role = "robot" and clock_offset_s = {offset_s:.2f} in cell.toml'
    ),
    "clock-by-start": (
        "aligned by the time of day of its start: accurate to about a second, so no delay can be read from it"
    ),
    "clock-motion-ambiguous": (
        "its motion fits the robot's almost as well {away_s:+.2f} s away ({height:.0%} of the correlation), "
        "probably because the robot repeats its motion: log a motion that occurs only once, or give sync"
    ),
    "clock-motion-rough": "its motion fits the robot's poorly (correlation {correlation:.2f})",
    "clock-events-few": "its clock is aligned on {events} event(s), too few to check it: record three or more",
    "clock-events-disagree": "the events that align its clock disagree by {residual_s:.2g} s: check the pairs",
    "clock-events-ambiguous": (
        "its events fit the robot's almost as well {away_s:+.2f} s away ({pairs:.0%} as many pairs): "
        "the clock may be off by that; record events at uneven intervals, or give sync_events"
    ),
    "clock-events-unmatched": "only {used} of {events} events align its clock: the others have no match",
    # frames
    "frame-assumed": (
        "the tracker's pose is not given, so its axes are taken as those of the robot base; the slow-downs do not "
        "confirm that: give frame in cell.toml (`cyclekit calibrate points.csv` computes it); if the tracker's clock "
        "may be off, ingest with --align-clocks logs"
    ),
    "frame-doubtful": (
        "the tracker's frame is probably wrong: the robot slows at distances that differ by {spread_m:.2f} m (median), "
        "but only by {then_m:.2f} m if the positions move by {moved_m:.2f} m; check frame in cell.toml; "
        "proposed: {line}"
    ),
    # operator
    "tracks-linked": (
        "{ids} track ids in {frames} frames last only a frame or two: linked by motion into {tracks} tracks"
    ),
    "positions-too-fast": "{count} positions are unknown, because they imply a person faster than 20 m/s",
    "height-changes": (
        "the height of a person changes by {height_m:.1f} m: check which axis points up, and frame in cell.toml"
    ),
    "heights-unknown": "heights are unknown: distances are horizontal",
    "wait-contradicted": (
        "[[waits]] in cell.toml: the {agent} is said to wait {where} until {until}, but only {obeyed} of {passages} "
        "logged passages came after that: estimates of orders may end in deadlocks; correct or remove it"
    ),
    # task lists
    "listed-of-robot": "{tasks} tasks of the robot are not used: its log already shows them",
    "listed-outside": "{outside} of {tasks} tasks of the operator are outside of every execution",
    # the dataset
    "made-anew": "the existing dataset was damaged, or of another version, and was made again",
    "repaired": "made again, because files had changed since they were written: {files}",
    "source-without-log": "source {path!r} of the cell file matches no log",
    "source-in-folders": (
        'source {path!r} of the cell file matches no log: the logs of that name lie in folders; write path = "{glob}"'
    ),
    "no-positions": "no positions of robot and people: train learns task times and waits, and no safety function",
    "no-robot-log": (
        "there is no robot log, which training and estimates need: put the robot controller's log into the session's "
        "folder, and ingest both"
    ),
    "logs-unpaired": (
        "{robots} robot logs ({robot}, …) have no log of people, {others} logs ({other}, …) no robot log: unclear "
        "which belong together. Put each session into its own folder, or give its logs the "
        "same name in their folders (robot/a.csv, tracker/a.csv)"
    ),
    # the speed scaling
    "scaling-unknown": lambda values: f"{_scaling(values)}; it cannot be inferred either, because no motion repeats",
    "scaling-inferred": _scaling_inferred,
    "scaling-constant": (
        "the logged speed scaling never changes, but in {share:.0%} of the motion the robot is slower than in its "
        "fastest repetitions: it is taken for the override that was set, and the scaling is inferred from the motion"
    ),
    "override-moved": lambda values: _override(values, "it counts as the safety function's scaling"),
    "override-of-program": lambda values: _override(
        values,
        "the program sets it by the robot's position, whoever is near, so estimates are slow at the same positions; "
        "time lost to it is shown with the safety function's",
    ),
    "override-unknown": lambda values: _override(
        values,
        "neither a program that follows people nor a hand is shown to move it, so no cycle time can be estimated "
        "(set_override in cell.toml says which, if you know)",
    ),
    "scaling-of-safety-log": lambda values: (
        f"{_overrides(values)} taken for the robot's speed scaling: its motion agrees to "
        f"{fixed(float(values['error']), 3)} (median), {_later(values)}"
    ),
    "override-not-followed": lambda values: (
        f"{_overrides(values)} not taken for the robot's speed scaling: its motion differs by "
        f"{fixed(float(values['error']), 3)} (median), at best {_later(values)}; if the clocks are farther apart, "
        "give clock_offset_s or sync in cell.toml"
    ),
    "override-not-compared": lambda values: (
        f"{_overrides(values)} not taken for the robot's speed scaling: too little motion to compare them"
    ),
    "input-slows": (
        "while {signal} is {state}, the robot runs at {percent} % speed at most, independent of the operator's position"
    ),
    "executions-interrupted": (
        "{count} of {all} executions were interrupted: the program was paused, or the robot stood for longer than a "
        "usual execution takes, for no reason that the logs show (longest: {longest_s:.0f} s in {execution}). "
        "Estimates are for cycles without interruptions; with them, a cycle takes {mean_s:.1f} s longer on average"
    ),
    "operator-signal": (
        "{signal} = {occupied} is taken as a person's presence: the speed responds {delay_s:.2f} s later, and "
        "{explained:.0%} of the lost time is explained; if that is wrong, name the right signals: "
        "[[operator_signals]] in cell.toml"
    ),
    "operator-stop": (
        "{signal} = {occupied} is taken as a person's presence, which lasts until {reset} changes to {reset_at} (a "
        "reset button): the speed responds {delay_s:.2f} s later, and {explained:.0%} of the lost time is explained; "
        "if that is wrong, name the right signals: [[operator_signals]] in cell.toml"
    ),
    "signals-restarted": (
        "in {sessions} session(s) the robot's clock was restarted while recording: the times of its signals belong to "
        "several parts of the log, so no signal shows people there; split the robot's log at the restart"
    ),
    "signals-follow": (
        "no signal of people was found; {signals} change {late_s:.2f} s after the speed, as a lamp does: "
        "if it is a field that is logged late, name it under [[operator_signals]] in cell.toml"
    ),
    "places-once": (
        "{count} of {of} places were visited in one execution only: if the robot was stopped there midway (by a door "
        "or an emergency stop that the logged scaling does not show), name its places in cell.toml and set "
        "all_places_named = true"
    ),
    "people-mixed": (
        "positions of people are known in {positions} executions, signals of them in {signals}, neither in {neither}: "
        "`train` uses the kind that more executions have"
    ),
    "tracker-empty": lambda values: (
        f"tracker logs with a header and no rows: {values['absent']} sessions count as without an operator"
        + (f", {values['unknown']} as unknown (silence in cell.toml says which)" if values["unknown"] else "")
    ),
    "people-learned": (
        "learned from {what} of people in {used} executions; {left} executions with {other} only are left out: "
        "train --people {other} learns from those"
    ),
    "operator-unseen": (
        "in {samples} samples of {sessions} sessions a signal shows a person whom the tracker does not see: the "
        "operator counts as occluded, not as absent"
    ),
    "scaling-nowhere": "the scaling is unknown everywhere",
    "levels-none": "no value of the scaling is held long enough to be a level: a continuous function, or none at all",
    "levels-one": "only one level, {level:.2f}: the logs show no slow-down, or no full speed",
    "levels-many": "{levels} levels are too many for discrete levels: a continuous function",
    "levels-wide": "values around {values} form no clear level: a continuous function",
    "levels-left": "{unknown:.0%} of the known samples are on no level: ramps, or no discrete levels",
    "scaling-continuous": "{varied:.0%} of the known samples lie on slopes of many rates: a continuous function",
    "levels-not-held": "only {held:.0%} of the known samples stay on one value: probably a continuous function",
    "levels-with-slider": (
        "the values are levels times an operator slider ({sliders}); the levels are given without it"
    ),
    "learned-in-files": (
        "more samples than fit into memory: levels were found in {executions} executions; training reads the samples "
        "from files"
    ),
    "model-data": "{text}",
    "model-beaten": "{text}",
    UNPROVEN: "{text}",
    "levels-disputed": (
        "{levels} levels by plateaus in time, {other} by K-means with silhouette: check the levels, "
        "and set them in cell.toml if you know them"
    ),
}
"""Sentence of each code; a function if it has variable parts."""

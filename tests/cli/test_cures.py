"""What a message tells a person to type or write is typed and written here, as it is printed."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
import typer

from cyclekit.cli import ORDER, app
from cyclekit.config import load_cell
from cyclekit.config.sequences import load_sequences
from cyclekit.errors import ConfigError, command_line
from cyclekit.estimate.plan import load_jobs
from cyclekit.estimate.whatif import load_changes
from cyclekit.fleet import load_fleet
from cyclekit.learning.networks.spec import ModelSpec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .conftest import Shell

ROOT = Path(__file__).parents[2]
SOURCES = [*ROOT.glob("cyclekit/**/*.py"), *ROOT.glob("adapters/cyclekit_adapters/**/*.py")]
COMMAND = re.compile(rf"\bcyclekit (?:{'|'.join(ORDER)})\b[^`\n,;()]*")


@cache
def trees() -> list[ast.Module]:
    """Return the sources that may advise something, parsed."""
    texts = (file.read_text(encoding="utf-8") for file in SOURCES)
    return [ast.parse(text) for text in texts if any(word in text for word in ("cyclekit ", "command_line", "cure"))]


def text_of(node: ast.AST) -> str:
    """The text of a literal, with `X` for what is only known when it runs; empty for anything else."""
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def texts_in(node: ast.AST) -> Iterator[str]:
    """All literal texts but docstrings."""
    if text := text_of(node):
        yield text
    elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
        for child in ast.iter_child_nodes(node):
            yield from texts_in(child)


def advised_commands() -> list[str]:
    """Every command that some text of the sources advises."""
    found = set[str]()
    for tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "command_line" and not node.keywords:
                found.add(shlex.join(["cyclekit", *(text_of(word) or "X" for word in node.args)]))
        found.update(match.strip(" .'") for text in texts_in(tree) for match in COMMAND.findall(text))
    return sorted(each for each in found if each.isascii() and len(each.split()) > 2 and "-->" not in each)


@pytest.fixture(scope="module")
def commands() -> dict[str, Any]:
    return dict(typer.main.get_command(app()).commands)  # type: ignore[attr-defined]


def test_every_command_that_is_advised_can_be_typed(commands: dict[str, Any]):
    for advised in advised_commands():  # not one test each: whoever collects the tests would read all sources
        _, name, *words = shlex.split(advised)
        values = [
            "now" if ahead == "--problem" and w == "X" else w for ahead, w in zip(["", *words], words, strict=False)
        ]
        try:
            commands[name].make_context(name, values)
        except Exception as error:  # of typer, which keeps them to itself
            error.add_note(advised)
            raise


def test_every_option_that_a_cure_names_exists(commands: dict[str, Any]):
    each = [option for command in commands.values() for option in command.params]
    known = {name for option in each for name in (*option.opts, *option.secondary_opts)}
    named = set[str]()
    for node in (node for tree in trees() for node in ast.walk(tree)):
        if isinstance(node, ast.keyword) and node.arg == "cure":
            named.update(word for text in texts_in(node.value) for word in re.findall(r"--[a-z][a-z-]+", text))
    assert len(named) > 8
    assert named <= known


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ModelSpec, "of", partial(ModelSpec.of, epochs=1))  # a training of a second


TYPED = set[tuple[str, ...]]()
"""Command lines that worked: a second one of the same words would do the same once more."""


@pytest.fixture
def typed(cyclekit: Shell, logs: Path, dataset: Path, model: Path, sequences: Path):
    """Type a printed command; what stands in capitals is put in by the person who types."""
    inputs = {"LOGS": logs, "DATASET": dataset, "MODEL": model, "SEQUENCES.toml": sequences}

    def type_it(printed: str, *, again: bool = True) -> int:
        _, *words = shlex.split(printed)
        made = [f"new-{word}" if words[at - 1] == "--out" and word in inputs else word for at, word in enumerate(words)]
        line = tuple(str(inputs.get(word, word)) for word in made)
        if line in TYPED and not again:
            return 0
        done = cyclekit(*line)
        assert done.code == 0, (printed, done.err)
        TYPED.add(line)
        return done.code

    return type_it


def commands_of(text: str) -> list[str]:
    """The commands of a message; two of them stand beside each other with `, or` between."""
    found = [part for line in text.splitlines() for part in re.split(r", or (?=cyclekit)", line)]
    return [part[part.index("cyclekit ") :] for part in found if COMMAND.search(part)]


WRONG = {
    "a model as dataset": ("train", "{model}", "--out", "m"),
    "no such dataset": ("train", "my data", "--out", "m"),
    "logs as dataset": ("train", "{logs}", "--out", "m"),
    "a sequence file as dataset": ("train", "{sequences}", "--out", "m"),
    "a file as dataset": ("train", "{logs}/truth/truth.json", "--out", "m"),
    "no such model": ("zones", "my model", "{dataset}"),
    "a dataset as model": ("zones", "{dataset}", "{dataset}"),
    "a sequence file as model": ("zones", "{sequences}", "{dataset}"),
    "a sequence file as log": ("inspect", "{sequences}"),
    "a card as log": ("inspect", "{dataset}/dataset.json"),
}


@pytest.mark.parametrize("case", WRONG)
def test_the_cure_of_what_was_given_in_place_of_something_else_works_as_it_is_printed(
    case: str, cyclekit: Shell, typed: Any, logs: Path, dataset: Path, model: Path, sequences: Path
):
    paths = {"logs": logs, "dataset": dataset, "model": model, "sequences": sequences}
    words = [word.format(**paths) for word in WRONG[case]]
    failed = cyclekit(*words)
    assert failed.code == 1
    (cure,) = commands_of(failed.err)
    typed(cure, again=case.startswith("no such"))
    if case.startswith("no such"):
        assert cyclekit(*words).code == 0


def test_a_folder_of_models_is_told_with_the_models_in_it(cyclekit: Shell, model: Path, dataset: Path):
    for seed in (1, 2):
        shutil.copytree(model, Path("models") / f"seed-{seed}")
    failed = cyclekit("zones", "models", dataset)
    chosen = re.search(r"Choose one of them: ([^,]+),", failed.err)
    assert chosen is not None
    assert cyclekit("zones", chosen[1], dataset).code == 0


@pytest.mark.parametrize("kind", [load_sequences, load_changes, load_fleet, load_jobs])
def test_what_is_to_be_added_to_an_empty_file_is_toml_that_is_read(kind: Any, tmp_path: Path):
    file = tmp_path / "x.toml"
    file.write_text("", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        kind(file)
    file.write_text(str(caught.value.cure).partition("\n")[2], encoding="utf-8")
    assert kind(file)


def test_a_list_that_is_none_is_shown_as_one(tmp_path: Path):
    file = tmp_path / "x.toml"
    file.write_text('[[sequence]]\nname = "A"\nplaces = "home"\n', encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_sequences(file)
    assert caught.value.cure == 'places = ["home"]'
    file.write_text('[sequence]\nname = "A"\n', encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_sequences(file)
    assert caught.value.cure == "Begin each of them with [[sequence]]."


def test_the_line_that_is_to_be_mended_is_named(tmp_path: Path):
    file = tmp_path / "cell.toml"
    for content, said in (
        ('name = "a"\n# Kühlregal\n'.encode("latin-1"), "line 2 is not text in UTF-8 (byte 0xfc)"),
        (b'name = "a"\nrate_hz = = 2\n', "at line 2"),
        (b'name = """a\n', "end of document"),
    ):
        file.write_bytes(content)
        with pytest.raises(ConfigError) as caught:
            load_cell(file)
        assert said in str(caught.value)
        assert ("line named above" in str(caught.value)) == ("at line" in said)


def test_what_comes_next_can_be_typed_where_the_path_has_blanks(cyclekit: Shell, typed: Any, logs: Path):
    done = cyclekit("ingest", logs, "--out", "my data")
    inspect, train = commands_of(done.out)
    assert shlex.split(inspect) == ["cyclekit", "inspect", "my data"]
    typed(inspect)
    typed(train)


@pytest.mark.parametrize("problem", ["now", pytest.param("ahead", marks=pytest.mark.slow)])
def test_what_comes_next_after_a_training_works(problem: str, cyclekit: Shell, typed: Any, dataset: Path):
    done = cyclekit("train", dataset, "--problem", problem, "--out", "my model")
    assert done.code == 0, done.err
    assert ("answers: the rule" in done.out or "the network answers" in done.err) == (problem == "now")
    (following,) = commands_of(done.out)
    typed(following)


def test_a_command_is_quoted_as_the_system_wants_it(monkeypatch: pytest.MonkeyPatch):
    assert command_line("inspect", Path("a b")) == "cyclekit inspect 'a b'"
    monkeypatch.setattr("cyclekit.errors.os", SimpleNamespace(name="nt"))
    assert command_line("inspect", "a b") == 'cyclekit inspect "a b"'

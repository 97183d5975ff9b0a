"""What the documents say can be typed: every `cyclekit ...` line in them is a command line that parses."""

from __future__ import annotations

import ast
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest
import typer.main

from cyclekit.cli import app
from cyclekit.config import load_cell
from cyclekit.config.project import load_project
from cyclekit.config.sequences import load_sequences
from cyclekit.estimate.plan import load_jobs
from cyclekit.estimate.plan.task_orders import load_task_jobs
from cyclekit.estimate.whatif import load_changes
from cyclekit.fleet import load_fleet
from cyclekit_sim import read_rule

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *ROOT.glob("[!.]*/README.md")])
FRAME = typer.main.get_command(app())
COMMANDS = FRAME.commands  # type: ignore[attr-defined]
_BLOCK = re.compile(r"^```(?:console|sh|bash|shell)?\n(.*?)^```", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"`(cyclekit [^`]+)`")


def command_lines(document: Path) -> list[str]:
    """Return the command lines of a document: in code blocks, and between backticks."""
    text = document.read_text(encoding="utf-8")
    found = []
    for block in _BLOCK.findall(text):
        joined = re.sub(r"\\\n\s*", " ", block)
        lines = [line.strip().removeprefix("$ ") for line in joined.splitlines()]
        found += [line.partition(" #")[0].strip() for line in lines if line.startswith("cyclekit ")]
    return found + _INLINE.findall(re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL))


LINES = [(document.relative_to(ROOT).as_posix(), line) for document in DOCUMENTS for line in command_lines(document)]
LINES += [
    (f"cyclekit {name} --help", str(command.epilog).splitlines()[2].strip()) for name, command in COMMANDS.items()
]


def test_the_documents_show_command_lines() -> None:
    assert {"README.md", "docs/commands.md"} <= {document for document, _ in LINES}


@pytest.mark.parametrize(("document", "line"), LINES)
def test_a_command_line_of_the_documents_has_a_known_command_and_known_options(document: str, line: str) -> None:
    words = shlex.split(line.replace("…", "").replace("[", "").replace("]", ""))[1:]
    if words[0].startswith("--"):
        assert words[0] in {"--help", *(option for parameter in FRAME.params for option in parameter.opts)}
        return
    assert words[0] in COMMANDS, f"{document}: no command {words[0]!r}"
    known = {option for parameter in COMMANDS[words[0]].params for option in parameter.opts} | {"--help", "-h"}
    used = [word.partition("=")[0] for word in words[1:] if word.startswith("-")]
    assert [option for option in used if option not in known] == [], f"{document}: {line}"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_each_of_its_options_is_described(name: str) -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    section = re.search(rf"^## cyclekit {name}\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    assert section, f"docs/commands.md has no section '## cyclekit {name}'"
    options = {opt for parameter in COMMANDS[name].params for opt in parameter.opts if opt.startswith("--")}
    shared = {"--json", "--quiet", "--help"}
    assert [option for option in sorted(options - shared) if f"`{option}" not in section[1]] == []


def test_no_command_that_is_gone_has_a_section() -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^## cyclekit (\S+)", page, re.MULTILINE)) == set(COMMANDS)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_link_in_a_document_leads_somewhere(document: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]+)", document.read_text(encoding="utf-8"))
    local = [link for link in links if "://" not in link]
    assert [link for link in local if not (document.parent / link).exists()] == []


def anchors(document: Path) -> set[str]:
    """Return the anchors of a page's headings, made as GitHub makes them."""
    prose = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", prose, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_link_to_a_heading_leads_to_a_heading(document: Path) -> None:
    links = re.findall(r"\]\(([^)#\s:]*\.md)?#([^)\s]+)\)", document.read_text(encoding="utf-8"))
    pages = [((document.parent / page) if page else document, anchor) for page, anchor in links]
    assert [f"{page.name}#{anchor}" for page, anchor in pages if anchor not in anchors(page)] == []


def test_the_index_lists_every_page_by_its_question() -> None:
    linked = set(re.findall(r"\]\(([^)#\s]+)", (ROOT / "docs" / "index.md").read_text(encoding="utf-8")))
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert pages - linked == set()
    for folder in (ROOT / "docs" / "notebook", ROOT / "docs" / "notebook" / "tables"):
        notes = {page.name for page in folder.glob("*.md")} - {"README.md"}
        listed = (folder / "README.md").read_text(encoding="utf-8")
        assert notes
        assert [note for note in sorted(notes) if f"]({note})" not in listed] == []


def test_every_picture_of_the_documentation_is_shown_on_a_page() -> None:
    text = "".join(document.read_text(encoding="utf-8") for document in DOCUMENTS)
    pictures = [path for path in (ROOT / "docs" / "pictures").iterdir() if path.suffix in {".png", ".svg"}]
    assert [picture.name for picture in pictures if f"pictures/{picture.name})" not in text] == []


def blocks(language: str) -> list[tuple[str, str]]:
    """Return every code block of a language, with its document."""
    pattern = re.compile(rf"^```{language}\n(.*?)^```", re.MULTILINE | re.DOTALL)
    return [
        (document.relative_to(ROOT).as_posix(), block)
        for document in DOCUMENTS
        for block in pattern.findall(document.read_text(encoding="utf-8"))
    ]


@pytest.mark.parametrize(("document", "block"), blocks("toml"))
def test_a_toml_example_is_a_file_that_is_accepted(document: str, block: str, tmp_path: Path) -> None:
    file = tmp_path / "example.toml"
    file.write_text(block, encoding="utf-8")
    if "[[cell]]" in block:
        assert load_fleet(file), document
    elif "[[sequence]]" in block:
        assert load_sequences(file), document
    elif "[[change]]" in block:
        assert load_changes(file), document
    elif "[[task]]" in block:
        assert load_task_jobs(file).task, document
    elif "visit = " in block:
        assert load_jobs(file), document
    elif "logs = [" in block:
        assert load_project(file), document
    elif "[[limits]]" in block or "[law]" in block:
        assert read_rule(file), document
    else:
        assert load_cell(file), document


@pytest.mark.parametrize(("document", "block"), blocks("python"))
def test_a_python_example_compiles_and_imports_names_that_are_there(document: str, block: str) -> None:
    tree = ast.parse(block, document)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = import_module(node.module)
            assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == []


def test_the_list_of_commands_holds_whole_sentences_in_80_columns() -> None:
    with typer.Context(FRAME, terminal_width=80, max_content_width=80) as context:
        listed = FRAME.get_help(context).partition("Commands:")[2]
    assert all(name in listed for name in COMMANDS)
    assert "..." not in listed
    daily, tools = listed.split("Tools:")
    assert "  estimate " in daily
    assert "  convert " in tools

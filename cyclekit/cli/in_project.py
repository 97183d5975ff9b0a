"""Takes missing arguments of a command from the project file of the working directory (cyclekit.toml).

Arguments on the command line take precedence. The model may be omitted before a `.toml` file: `cyclekit plan
jobs.toml`; so may model and sequences before a file of changes: `cyclekit whatif changes.toml`. Optional arguments (a
takt, the model of a report) are taken only if dataset or logs are taken, too.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer.core import TyperArgument, TyperCommand, TyperOption

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cyclekit.config.project import Project

PROJECT_FILE = "cyclekit.toml"
_ESTIMATE = {"model": "model", "sequences": "sequences", "dataset": "dataset", "takt": "takt"}
KINDS = {
    "<str>": "TEXT",
    "<path>": "PATH",
    **dict.fromkeys(("<int>", "<float>", "<int range>", "<float range>"), "NUMBER"),
}
"""How the help calls the kinds of values."""
PATHS: dict[str, dict[str, str]] = {
    "ingest": {
        **{"logs": "logs", "out": "dataset", "cell": "cell", "align_clocks": "align_clocks"},
        **{"pseudonymise": "pseudonymise", "follow_links": "follow_links"},
    },
    "inspect": {"path": "made", "sequences": "sequences_there"},
    "trace": {"dataset": "dataset"},
    "levels": {"dataset": "dataset"},
    "train": {"dataset": "dataset", "out": "model"},
    "evaluate": {"model": "model", "dataset": "dataset"},
    "estimate": {**_ESTIMATE, "baseline": "baseline"},
    "gate": _ESTIMATE,
    "plan": {"model": "model", "jobs": "jobs", "dataset": "dataset"},
    "zones": {"model": "model", "dataset": "dataset"},
    "whatif": {"model": "model", "sequences": "sequences", "dataset": "dataset"},
    "replay": {"dataset": "dataset", "model": "model"},
    "report": {
        **{"dataset": "dataset", "model": "model", "sequences": "sequences", "takt": "takt"},
        **{"out": "report", "template": "template", "baseline": "baseline"},
    },
    "export": {"model": "model"},
}
"""By command: parameters that a project can fill, and their keys; `made` = the dataset if it exists, else the logs."""


class InProject(TyperCommand):
    """A command that takes missing arguments from the project file."""

    def __init__(self, *args: Any, **settings: Any) -> None:  # noqa: ANN401 - typer's own
        """Make the command; its help names no types of Python, and those of arguments only if they are choices."""
        super().__init__(*args, **settings)
        for each in self.params:
            shown = _choice if isinstance(each, TyperArgument) else _kind
            if isinstance(each, TyperArgument | TyperOption):
                each.display_type_rich = partial(shown, each.display_type_rich)  # type: ignore[method-assign]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - typer has its own copy of click
        """Parse the command line, and print the arguments taken from the project file."""
        keys = PATHS.get(self.name or "", {})
        if not keys or not Path(PROJECT_FILE).is_file():
            return super().parse_args(ctx, args)
        if set(args) & set(self.get_help_option_names(ctx)):
            return super().parse_args(ctx, args)  # the help shows defaults, which would be those of the project
        typed, _, _ = self.make_parser(ctx).parse_args(list(args))
        found = _LeftOut(typed.get("logs") or ())
        if self.params[0].name == "model" and str(typed.get("model")).endswith(".toml"):
            alone = typed.get("sequences") is None and any(each.name == "changes" for each in self.params)
            left_out = ["model", "sequences"] if alone else ["model"]
            args = [*(str(found.value(name, name)) for name in left_out), *args]
        needed = {each.name for each in self.params if each.required}
        anchors = {"dataset", "logs", "path"} & needed
        ctx.default_map = {
            name: partial(found.value, name, key, None if name in needed else anchors) for name, key in keys.items()
        }
        rest = super().parse_args(ctx, args)
        if found.taken and not ctx.params.get("quiet"):
            from cyclekit.cli.terminal import Terminal

            settings = ", ".join(f"{name} = {value}" for name, value in found.taken.items())
            Terminal(json=False, quiet=False).remark(f"from {PROJECT_FILE}: {settings}")
        return rest


def _kind(shown: Callable[..., str | None], ctx: Any) -> str | None:  # noqa: ANN401 - typer has its own copy of click
    kind = shown(ctx=ctx)
    return KINDS.get(kind or "", kind)


def _choice(shown: Callable[..., str | None], ctx: Any) -> str:  # noqa: ANN401 - typer has its own copy of click
    kind = shown(ctx=ctx) or ""
    return kind if "|" in kind else ""


class _LeftOut:
    """Values of the project file, which is read at the first request, and a record of those taken."""

    def __init__(self, logs: Sequence[str]) -> None:
        self.taken: dict[str, str] = {}
        self._logs = tuple(Path(log).resolve() for log in logs)
        self._project: Project | None = None

    @property
    def project(self) -> Project:
        """The project file."""
        if self._project is None:
            from cyclekit.config.project import load_project

            self._project = load_project(Path(PROJECT_FILE))
        return self._project

    def value(self, name: str, key: str, anchors: set[str] | None = None) -> Any:  # noqa: ANN401 - a text, or several
        """Return the value of a parameter; None if the project has none, or if none of `anchors` was taken."""
        typed = bool(self._logs) and self._logs == tuple(Path(log).resolve() for log in self.project.logs)
        if anchors is not None and not anchors & (set(self.taken) | ({"logs"} if typed else set())):
            return None
        if name == "baseline" and "sequences" not in self.taken:  # a baseline is one of the project's sequences
            return None
        project = self.project
        if key == "sequences_there":
            return project.sequences if Path(project.sequences).exists() else None
        if key == "made":
            key = "dataset" if Path(project.dataset).exists() or "://" in project.dataset else "logs"
        value = getattr(project, key)
        if key == "logs" and name == "path":
            (value, *_) = value
        if value is not None and value is not False:
            self.taken[name] = " ".join(value) if isinstance(value, tuple) else value
        return list(value) if isinstance(value, tuple) else value

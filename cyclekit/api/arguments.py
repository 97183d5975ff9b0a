"""Type checks of the arguments of public functions, by their annotations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ReplacedDataset, UnknownName, WrongType
from cyclekit.schema import Progress as Progress

TRIES = 3
"""How often a call reads a dataset that others replace meanwhile; a default against an endless loop."""

P = ParamSpec("P")
R = TypeVar("R")

Place = str | Path


def checked(function: Callable[P, R], home: str | None = None, name: str | None = None) -> Callable[P, R]:
    """Return a function whose arguments are checked in each call.

    It begins again if another process replaces a dataset that it opened, at most `TRIES` times.

    Args:
        function: A function of this package, or of a room below, with the public signature.
        home: Module in which it is public, if different from its own.
        name: Public name, if different from its own.

    Raises:
        WrongType: An argument is not of the annotated type.
        UnknownName: A text is not one of a `Literal`.
    """
    known = signature(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        hints = get_type_hints(function)
        for each, value in known.bind(*args, **kwargs).arguments.items():
            _check(call.__name__, each, value, hints[each])
        for _ in range(TRIES - 1):
            try:
                return function(*args, **kwargs)
            except ReplacedDataset:
                if any(isinstance(value, Dataset) for value in (*args, *kwargs.values())):
                    raise
        return function(*args, **kwargs)

    call.__module__, call.__qualname__ = home or function.__module__, name or function.__qualname__
    call.__name__ = name or function.__name__
    return call


def _check(function: str, name: str, value: object, kind: Any) -> None:  # noqa: ANN401 - an annotation is any object
    if fits(value, kind):
        return
    names = [text for one in _members(kind) if get_origin(one) is Literal for text in get_args(one)]
    if isinstance(value, str) and names:
        raise UnknownName(f"{function}(): {name}", "name", value, names)
    raise WrongType(function, name, value, expected(kind))


def fits(value: object, kind: Any) -> bool:  # noqa: ANN401
    """Return whether a value has an annotated type, including items of sequences."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        return any(fits(value, one) for one in get_args(kind))
    if origin is Literal:
        return value in get_args(kind) if isinstance(value, str | int) else False
    if origin is Callable:
        return callable(value)
    if origin in (Sequence, list, tuple):
        if not isinstance(value, Sequence) or isinstance(value, str | bytes):
            return False
        return all(fits(item, get_args(kind)[0]) for item in value)
    if origin is Mapping:
        return isinstance(value, Mapping)
    if kind in (int, float):
        return isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
    return isinstance(value, NoneType if kind is None else kind)


def expected(kind: Any) -> str:  # noqa: ANN401
    """Return an annotated type as text: `str, Path or Dataset`."""
    names = list(dict.fromkeys(_named(one) for one in _members(kind)))
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def _members(kind: Any) -> tuple[Any, ...]:  # noqa: ANN401
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def _named(kind: Any) -> str:  # noqa: ANN401
    origin = get_origin(kind)
    if kind in (None, NoneType):
        return "None"
    if origin is Literal:
        return " or ".join(repr(one) for one in get_args(kind))
    if origin is Callable:
        return "a function"
    if origin in (Sequence, list, tuple):
        return f"a list of {expected(get_args(kind)[0])}"
    return str(getattr(origin or kind, "__name__", kind))

"""Merging of similar sources in a drafted cell file: `day*/people.csv` instead of one source per day.

A plant logs one file per execution or day, and one correction should apply to all of them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from cyclekit.config import Source

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cyclekit.adapter import Draft

    _Sources = list[tuple[Source, Draft | None]]

_UNIT = "_unit"
_DIGITS = "0123456789"


def merge_similar(
    known: Sequence[Source], drafted: Mapping[str, tuple[str, Draft]], unread: Collection[str]
) -> tuple[list[Source], dict[str, Draft]]:
    """Return sources and drafts, by path, with groups of similar sources merged into one with a glob.

    Args:
        known: Sources that an adapter recognises, or that the cell file lists.
        drafted: Tables that no adapter recognises: path -> adapter that made the draft, and draft.
        unread: All files that no adapter reads.
    """
    sources: _Sources = [(source, None) for source in known]
    sources += [(Source(shown, adapter), draft) for shown, (adapter, draft) in drafted.items()]
    groups: dict[object, _Sources] = {}
    for source, draft in sources:
        plain = source == Source(source.path, source.adapter)
        key = (source.adapter, draft is None, kind_of(source.path)) if plain else source.path
        groups.setdefault(key, []).append((source, draft))
    alone: _Sources = []
    globs: _Sources = []
    for group in groups.values():
        of, first = [source.path for source, _ in group], group[0][0]
        draft = _agreed([draft for _, draft in group if draft is not None])
        if draft is not None:
            of += [name for name in unread if kind_of(name) == kind_of(first.path) and name not in of]
            draft = replace(draft, notes=(*draft.notes, f"for {len(of)} files"))
        others = set(unread) - set(of) - set(drafted)
        free = (glob for glob in _globs(of) if not any(fnmatchcase(name, glob) for name in others))
        glob = next(free, None)
        if len(of) < 2 or glob is None or (draft is None and group[0][1] is not None):
            alone += group
        else:
            globs.append((replace(first, path=glob), draft))
    found = [*alone, *globs]  # the first match counts, so a glob follows the paths that it must not match
    return [source for source, _ in found], {source.path: draft for source, draft in found if draft is not None}


def kind_of(path: str) -> str:
    """Return a path with all digits replaced, equal for files of one kind."""
    return re.sub(r"\d+", "#", path)


def _globs(paths: Sequence[str]) -> list[str]:
    """Return globs for paths of one kind, the widest first; none if a name contains a glob character.

    The widest also matches later files: `run_*.csv` for `run_001.csv` to `run_060.csv`, and not `run_0*.csv`.
    """
    if any(character in path for path in paths for character in "*?["):
        return []
    wide, narrow = [], []
    for each in zip(*(path.split("/") for path in paths), strict=True):
        begin = _beginning(each)
        left = [name[len(begin) :] for name in each]
        end = _beginning([name[::-1] for name in left])[::-1]
        narrow.append(f"{begin}*{end}" if any(left) else begin)
        letters = begin.rstrip(_DIGITS) or begin  # a file of digits alone keeps its first ones
        wide.append(f"{letters}*{end.lstrip(_DIGITS)}" if any(left) else begin)
    return ["/".join(wide), "/".join(narrow)]


def _beginning(names: Sequence[str]) -> str:
    """Return the common prefix of all names."""
    first, last = min(names), max(names)
    same = next((at for at, (one, other) in enumerate(zip(first, last, strict=False)) if one != other), len(first))
    return first[:same]


def _agreed(drafts: Sequence[Draft]) -> Draft | None:
    """Return the most certain of several drafts; None if they differ in more than unsure values and units."""
    if not drafts:
        return None
    best = min(drafts, key=lambda draft: draft.unsure)
    mine = {proposal.key: proposal for proposal in (*best.source, *best.map)}
    for draft in drafts:
        for proposal in (*draft.source, *draft.map):
            other = mine.get(proposal.key)
            if other is None or (other.value != proposal.value and (proposal.sure or not _may_differ(proposal.key))):
                return None
    return best


def _may_differ(key: str) -> bool:
    return key.endswith(_UNIT)

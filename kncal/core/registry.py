"""Things that are chosen by name: kncal's own, and those that installed packages add by an entry point."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, TypeVar

from kncal.core.checks import one_of
from kncal.core.errors import InputError


class Named(Protocol):
    """What a registry holds: it says its own name."""

    @property
    def name(self) -> str:
        """The name that it is found by."""


T = TypeVar("T", bound=Named)


class Registry(Mapping[str, T]):
    """The entries of one kind by name: kncal's own in their order, then those of installed packages.

    A package adds an entry with an entry point of the group ``group``, called as the entry is: in its pyproject.toml
    ``[project.entry-points."kncal.laws"]`` and ``my_law = "my_package:MY_LAW"``. It is imported when it is asked for.
    It cannot take the name of one of kncal's own.

    Parameters
    ----------
    what : one entry, in a word, for errors: "law"
    kind : class of the entries
    own : kncal's own
    group : of entry points; "": packages cannot add to it
    """

    def __init__(self, what: str, kind: type[T], *own: T, group: str = "") -> None:
        self.what, self.kind, self.group = what, kind, group
        self._own = {entry.name: entry for entry in own}
        self._loaded: dict[str, T] = {}

    @cached_property
    def _added(self) -> dict[str, EntryPoint]:
        """The entry points of other packages by name."""
        found = entry_points(group=self.group) if self.group else ()
        return {point.name: point for point in found if point.name not in self._own}

    def __getitem__(self, name: str) -> T:
        if name in self._own:
            return self._own[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(self._added[name])
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        yield from self._own
        yield from self._added

    def __len__(self) -> int:
        return len(self._own) + len(self._added)

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._added

    def find(self, name: str | T) -> T:
        """Return the entry of a name, or an entry as it is.

        Raises
        ------
        InputError
            If it is neither, with the nearest name; or if the package that adds it is broken.
        """
        return name if isinstance(name, self.kind) else self[one_of(self.what, name, self)]

    def source(self, name: str) -> str:
        """Return the package, with its version, that adds the entry of this name; "" for kncal's own."""
        package = None if name in self._own else self._added[name].dist
        return "" if package is None else f"{package.name} {package.version}"

    def _load(self, point: EntryPoint) -> T:
        where = f"{self.what} {point.name!r} of the package {self.source(point.name)} (entry point {point.value})"
        try:
            entry = point.load()
        except Exception as error:  # code of others
            raise InputError(f"{where}: {type(error).__name__}: {error}; repair or uninstall the package") from error
        if not isinstance(entry, self.kind) or entry.name != point.name:
            raise InputError(f"{where}: expected a {self.kind.__name__} of this name, not {type(entry).__name__}")
        return entry

"""The engines by name: what each one solves, how it is made, and which programs it needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from kncal.core.installed import Finding
from kncal.core.registry import Registry
from kncal.engines.base import Engine
from kncal.engines.builtin import Builtin
from kncal.engines.coupled import Coupled
from kncal.engines.dpmfoam import installed as openfoam
from kncal.engines.liggghts import installed as liggghts
from kncal.engines.liggghts.batch import Liggghts
from kncal.scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class EngineEntry:
    """One engine.

    Attributes
    ----------
    name : as users choose it
    coupled : whether it solves scenes in which gas and particles exchange in intervals; else those of a few bodies
    make : returns it; takes ``ranks``, ``oversubscribe`` and, if ``coupled``, ``transport`` and ``gas``
    programs : each looks for a program that it needs on this machine
    """

    name: str
    coupled: bool = False
    make: Callable[..., Engine]
    programs: tuple[Callable[[], Finding], ...] = ()


#: Every engine; liggghts-hooke lets LIGGGHTS find the stiffness itself (method strain_energy only).
ENGINES = Registry(
    "engine",
    EngineEntry,
    EngineEntry(name="liggghts", make=Liggghts, programs=(liggghts.look,)),
    EngineEntry(name="builtin", make=Builtin),
    EngineEntry(name="liggghts-hooke", make=partial(Liggghts, "hooke"), programs=(liggghts.look,)),
    EngineEntry(name="coupled", coupled=True, make=Coupled, programs=(liggghts.look, openfoam.look)),
)


def get_engine(
    name: str, transport: str = "", *, ranks: int = 1, oversubscribe: bool = False, gas: bool = True
) -> Engine:
    """Return an engine by name, for runs on ``ranks`` ranks (see `kncal.core.mpi.check_ranks`).

    ``transport``, ``gas``: of a coupled one ("": "auto"); whether its scenes have gas.

    Raises
    ------
    InputError
        For an unknown name, or a number of ranks that cannot be.
    """
    entry = ENGINES.find(name)
    given: dict[str, Any] = {"transport": transport or "auto", "gas": gas} if entry.coupled else {}
    return entry.make(ranks=ranks, oversubscribe=oversubscribe, **given)


def engine_for(
    scene: Scene,
    name: str = "liggghts",
    transport: str = "auto",
    *,
    ranks: int = 1,
    oversubscribe: bool = False,
) -> Engine:
    """Return the engine that runs a scene: the coupled one, with ``transport``, or that of the ``name``.

    Raises
    ------
    InputError
        For an unknown name, or a number of ranks that cannot be.
    """
    coupled = next(entry.name for entry in ENGINES.values() if entry.coupled)
    used = coupled if scene.coupled else name
    return get_engine(used, transport, ranks=ranks, oversubscribe=oversubscribe, gas=scene.gas is not None)

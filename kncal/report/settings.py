"""What a report says of how its runs were made: numbers of the scene, contacts, conventions."""

from __future__ import annotations

from collections.abc import Iterable, Set
from typing import Any

from kncal.core.units import percent, quantity
from kncal.physics.drag import DRAGS
from kncal.physics.methods import METHODS
from kncal.report.page import Table
from kncal.scene.contact import ContactChoice
from kncal.scene.gas import Gas
from kncal.scene.model import Plan
from kncal.scene.pair_contact import bond_number
from kncal.scene.species import listed

_DEPTHS = {
    "walls": "walls in front and at the back",
    "periodic": "periodic in depth",
    "layer": "one layer of particles held in its plane, no walls in front and at the back",
}
_MODEL_B = (
    "Gas and particles: Gidaspow's model B. DPMFoam gives the whole pressure gradient to the gas. Its drag law, scaled"
    " by the void fraction, contains the pressure-gradient force, so this force is not added a second time. The gas"
    " equation carries the full weight of the gas, so each particle also gets the buoyancy V ρ_g g. The force on a"
    " particle is constant during a coupling interval; the gas makes one or more steps in it."
)
#: Contact end -> what it means.
_ENDS = {
    "overlap": "Contact end: the overlap is back at zero. Restitution and duration count to that moment. Shortly before"
    " it, a damped contact may pull.",
    "force": "Contact end: the normal force is back at zero. Attraction is cut off. Restitution and duration of the"
    " calibration count to that moment.",
}
#: Tangential damping of the case -> what it is.
_DAMPING_T = {
    "none": "no tangential damping",
    "liggghts": "where it sticks the damping ratio of the normal direction",
    "half_normal": "where it sticks half of the normal damping coefficient",
}


def run_settings(linear: Plan, hertz: Plan, costs: tuple[Any, Any]) -> Table:
    """Return how two coupled runs were made; ``costs`` say by which transport. Empty where nothing is coupled."""
    models = (linear, hertz)
    if not hertz.couplings:
        return Table((), ())
    scene = hertz.scene
    rows = _coupled(models, costs) if scene.run.coupling is not None else _granular(models)
    if scene.number and not scene.frozen:
        rows.insert(3, _each("DEM steps per interval", (str(m.steps_per_coupling) for m in models)))
    rows += [
        _both(
            f"particles {name}",
            f"{sum(c.number for c in scene.classes if c.group == name):,} of "
            f"{listed([quantity(c.diameter, 'm') for c in scene.classes if c.group == name])}, start: {group.place}",
        )
        for name, group in scene.particles.items()
    ]
    rows += [_each(f"contact {'–'.join(pair)}", (_contact(m, pair) for m in models)) for pair in hertz.named]
    return Table(("", "linear", "Hertz"), tuple(rows), text=(0, 1, 2))


def _granular(models: tuple[Plan, Plan]) -> list[tuple[str, str, str]]:
    scene = models[1].scene
    low, high = scene.extent
    periodic = f", periodic in {listed(scene.periodic)}" if scene.periodic else ""
    return [
        _each("interval", (quantity(m.coupling, "s") for m in models)),
        _both("domain (x, y, z)", " × ".join(quantity(s, "m") for s in (high - low).tolist()) + periodic),
        _both("walls", listed([f"{name} ({wall.shape})" for name, wall in scene.walls.items()]) or "none"),
    ]


def _coupled(models: tuple[Plan, Plan], costs: tuple[Any, Any]) -> list[tuple[str, str, str]]:
    scene = models[1].scene
    box, gas = scene.box, scene.gas
    rows = [
        _each("transport between the solvers", (c.transport for c in costs)),
        _each("coupling interval", (quantity(m.coupling, "s") for m in models)),
        _each("gas step", (quantity(m.gas_step, "s") if gas is not None else "–" for m in models)),
        _both("box (x, y, z)", " × ".join(quantity(s, "m") for s in box.size)),
        _both("front and back", _DEPTHS.get(scene.front_back, scene.front_back)),
    ]
    if gas is not None:
        edges = [size / n for size, n in zip(box.size, gas.cells, strict=True)]
        smallest = min(edge for axis, edge in zip("xyz", edges, strict=True) if axis != scene.layer)
        rows += [
            _both(
                "gas cells (x, y, z)",
                f"{' × '.join(map(str, gas.cells))}; smallest edge {smallest / scene.diameter:.3g} diameters",
            ),
            _both("drag law", f"{gas.drag}: {DRAGS.find(gas.drag).title}"),
            _both("gas enters", _inlet(gas)),
            _both("parcels per particle", str(gas.parcels_per_particle)),
        ]
    return rows


def _each(name: str, texts: Iterable[str]) -> tuple[str, str, str]:
    linear, hertz = texts
    return (name, linear, hertz)


def _both(name: str, text: str) -> tuple[str, str, str]:
    return (name, text, text)


def _inlet(gas: Gas) -> str:
    if gas.jet is not None:
        return f"jet of {quantity(gas.jet.velocity, 'm/s')}, {quantity(gas.jet.x_high - gas.jet.x_low, 'm')} wide"
    return f"ramp over {len(gas.ramp)} points" if gas.ramp else f"{quantity(gas.U_0, 'm/s')} over the floor"


def _contact(model: Plan, pair: tuple[str, str]) -> str:
    c = model.named.get(pair)
    if c is None:
        return "–"
    stiffness = f"k_n = {quantity(c.k, 'N/m', 4)}" if c.n == 1.0 else f"k_h = {c.k:.4g} N/m^1.5"
    words = [stiffness, f"e_n = {c.e_n:g}", f"friction {c.friction:g}"]
    if c.c_t > 0.0 and (e_t := c.stick_restitution()) is not None:
        words.append(f"e_t = {e_t:.3g} if it sticks")
    words += [f"rolling friction {c.rolling_friction:g} ({c.rolling_model})"] if c.rolling_friction > 0.0 else []
    if c.cohesion > 0.0:
        words.append(f"cohesion {c.cohesion:.4g} J/m³")
        bond = bond_number(c, model.species.bodies(model.species.pair_of(pair)), model.scene.g)
        words += [] if bond is None else [f"bond number {bond:.3g}"]
    return f"{c.law}: {', '.join(words)}, t_c = {quantity(c.t_c, 's', 3)}"


def conventions(linear: Plan, hertz: Plan, shown: Set[str]) -> tuple[str, ...]:
    """Return what the numbers mean; of the metrics only those in ``shown``."""
    scene = hertz.scene
    texts = [_MODEL_B] if scene.drag else []
    if hertz.contacts:
        ratios = {pair: c.k_t / c.k for pair, c in linear.named.items() if c.friction > 0.0}
        listed = ", ".join(f"{ratio:.3g} ({'–'.join(pair)})" for pair, ratio in ratios.items())
        how = "Mindlin's 4 G_eff/E_eff" if scene.contact.k_t_ratio is None else "as the case gives it"
        tangential = "no friction, so no tangential force in either run."
        if ratios:
            tangential = (
                f"linear k_t/k_n = {listed}, {how}; Hertz: Mindlin's 8 G_eff sqrt(R_eff δ). Both have friction with a"
                f" tangential spring and {_DAMPING_T[scene.contact.tangential_damping]}. The two decks differ only in"
                " the normal law, its tangential stiffness and the time step."
            )
        texts += [f"Tangential stiffness: {tangential}", _ENDS[scene.contact.end], _method(scene.contact)]
    if any(name.startswith("bubble_") for name in shown):
        texts.append("Bubbles are connected cells with a void fraction above 0.7 that do not reach the freeboard.")
    if "bed_height" in shown:
        texts.append("The bed height is where the laterally averaged void fraction crosses 0.8.")
    if "overlap_share" in shown:
        texts.append(f"overlap_share counts contacts above {percent(0.01).lstrip('+')} of the diameter.")
    return tuple(texts)


def _method(contact: ContactChoice) -> str:
    """What the method keeps and loses, or that the case prescribes k_n."""
    if contact.k_n is not None:
        return "The linear stiffness is prescribed by the case."
    m = METHODS.find(contact.method)
    return (
        f"Linear stiffness by {m.name}: {m.title}. Keeps {m.keeps}. Loses {m.loses}. Not for: {m.avoid}."
        f" Source: {m.source}."
    )

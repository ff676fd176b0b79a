"""``kncal kn``, ``kncal collide``: calibration without a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import Case, CaseFlags, ContactFlags, EngineFlags, Flags, Json, MethodFlags, refuse_ignored
from kncal.cli.kn_tables import MOST_TABLES, kn_data, kn_print, print_many, row_of
from kncal.cli.speeds import FromRun, Picture, Uncertain, kn_from_run, print_propagation, propagate_pair, texts
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.physics.material import Pair
    from kncal.scene.bodies import Body, Particle
    from kncal.scene.contact import ContactChoice
    from kncal.scene.scene import Scene

#: A block of more characters is for a file, not for a terminal: a dozen atom types.
_LONG_BLOCK = 20_000


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class BlockFlags(Flags):
    """The block to paste into a LIGGGHTS deck, and the time steps that are printed."""

    steps_per_contact: Annotated[
        float | None,
        Parameter(help="steps per contact N; default: that of the case, else 50 (more for a small e_n)"),
    ] = None
    style: Annotated[
        Literal["hooke/stiffness", "hooke", "hertz", "hertz/stiffness"],
        Parameter(help="LIGGGHTS' normal model in the block"),
    ] = "hooke/stiffness"
    friction: Annotated[
        float | None, Parameter(help="Coulomb friction in the block; default 0; not with a case, which has its own")
    ] = None


def kn(
    case: Case | None = None,
    *,
    contact: ContactFlags = ContactFlags(),
    how: MethodFlags = MethodFlags(),
    block: BlockFlags = BlockFlags(),
    from_run: FromRun = None,
    uncertain: Uncertain = None,
    picture: Picture = None,
    at: CaseFlags = CaseFlags(),
    by: EngineFlags = EngineFlags(),
    json: Json = False,
) -> None:
    """Calibrate the linear stiffness and damping by every method.

    Without CASE the flags describe one contact. With CASE: all pairs of the case. With --from-run: at the impact speeds
    that a run had. If CASE has contact.v_0 = "measured", it is run first: by --engine, in the folder --out.

    --method chooses whose numbers go into the block for LIGGGHTS.

    Example: kncal kn --young 70e9 --poisson 0.22 --density 2500 --radius 1e-3 --v0 0.5 --en 0.9
    """
    if from_run is not None:
        own = [*contact.given(), *(["--set"] if at.overrides else []), *([case] if case else [])]
        if own:
            raise InputError(f"{own[0]} and --from-run: the run's case holds these numbers: expected one or the other")
        refuse_ignored(
            "--from-run (the method is that of the run's case)",
            [*how.given(), *block.given(), *by.given(), *at.given()],
        )
        kn_from_run(from_run, uncertain or (), picture, json=json)
        return
    if picture is not None:
        raise InputError("--picture shows the impact speeds of a run: expected --from-run too, or leave it out")
    if case is None and at.overrides:
        raise InputError("--set needs a case whose values it replaces: name a case, or leave it out")
    if case is not None:
        if given := contact.given():
            raise InputError(
                f"{given[0]} and the case {case!r}: the case holds these numbers; expected one or the other"
            )
        ignored = [flag for flag in (*how.given(), *block.given()) if flag in ("--method", "--friction")]
        refuse_ignored(f"the case {case!r}, which holds its own", ignored)
        scene, folder = at.load(case)
        if scene.contact.measured is None:
            _refuse_measuring(at, by)
        by.check(scene)
        _kn_case(by.measured(scene, folder), uncertain or (), how.options, block, json=json)
        return
    _refuse_measuring(at, by)
    if uncertain:
        ignored = block.given()
        refuse_ignored("--uncertain, which gives the distribution of k_n alone", ignored)
        _kn_flags_uncertain(contact, uncertain, how, json=json)
    else:
        _kn_flags(contact, how, block, json=json)


def _refuse_measuring(at: CaseFlags, by: EngineFlags) -> None:
    """Refuse what is for a case whose impact speed is measured, by runs."""
    for name in (*by.given(), *(["--out"] if at.out else [])):
        raise InputError(f'{name} is for a case with contact.v_0 = "measured": leave it out')


def _kn_flags(flags: ContactFlags, how: MethodFlags, block: BlockFlags, *, json: bool) -> None:
    """Print the calibration of the contact that the flags describe."""
    from kncal.engines.liggghts.deck_block import matrix_block
    from kncal.physics.timestep import usual_steps

    pair, v_0, e_n = flags.pair(), flags.speed(), flags.restitution()
    steps = block.steps_per_contact
    steps = usual_steps(flags.law, e_n, flags.end) if steps is None else steps
    data = kn_data(pair, v_0, e_n, flags.law, flags.end, how.options, steps)
    text = matrix_block(flags.matrix(how), block.style, friction=block.friction or 0.0, steps_per_contact=steps)
    if json:
        show.as_json(data | {"liggghts": text})
        return
    kn_print(flags.title, data)
    _say_block(f"{how.method}, {block.style}", text)


def _kn_flags_uncertain(flags: ContactFlags, uncertain: Sequence[str], how: MethodFlags, *, json: bool) -> None:
    """Print how uncertain k_n of the contact that the flags describe is."""
    from kncal.physics.uncertainty import propagate

    material, radius, pair_of = flags.bodies()
    found = propagate(
        texts(uncertain),
        material=material,
        radius=radius,
        v_0=flags.v0,
        e_n=flags.en,
        pair_of=pair_of,
        law=flags.law,
        method=how.method,
        end=flags.end,
        **how.own(),
    )
    if json:
        show.as_json({"method": how.method, "uncertain": found.to_dict()})
    else:
        print_propagation(f"{flags.title}, {how.method}", found)


class _CasePair(NamedTuple):
    """A pair of species of a case: two bodies that stand for it, and what the case says; ``v_0``, ``k_n`` may be None.

    ``number``: of pairs of bodies that are alike (of groups: 1).
    """

    bodies: tuple[Particle, Body]
    pair: Pair
    e_n: float
    v_0: float | None
    k_n: float | None
    number: int = 1

    @property
    def name(self) -> str:
        """Both names as one."""
        return "–".join(body.name for body in self.bodies)


def _pairs(scene: Scene) -> Iterator[_CasePair]:
    """Every pair of species of a case."""
    from kncal.scene.plan import pair_of, species_choices
    from kncal.scene.species import species_of

    species = species_of(scene)
    for which, said in species_choices(scene).items():
        bodies = species.bodies(which)
        yield _CasePair(bodies, pair_of(*bodies), said.e_n, said.v_0, said.k_n, species.meetings(which))


def _kn_case(scene: Scene, uncertain: Sequence[str], options: dict[str, Any], block: BlockFlags, *, json: bool) -> None:
    """Print the calibration of all pairs of a case."""
    from kncal.engines.liggghts.deck_block import case_block

    contact = scene.contact
    steps = scene.run.steps_per_contact if block.steps_per_contact is None else block.steps_per_contact
    pairs = {pair.name: pair for pair in _pairs(scene)}
    many = len(pairs) > MOST_TABLES
    if many and uncertain:
        raise InputError(
            f"{scene.name}: {len(pairs)} pairs of unlike bodies: --uncertain takes at most {MOST_TABLES}: expected a "
            "case with fewer materials, sizes and exceptions"
        )
    result: dict[str, dict[str, Any]] = {}
    for name, p in pairs.items():
        given = options | dict(contact.options)
        data = kn_data(p.pair, p.v_0, p.e_n, contact.law, contact.end, given, steps, contact.method if many else None)
        if p.k_n is not None:
            data["methods"].append(_prescribed(contact, p, steps))
        beside = {} if many else _beside_the_normal(scene, p)
        result[name] = data | {"k_n_prescribed": p.k_n, "pairs_of_bodies": p.number, "contacts": beside}
    spreads = {
        name: propagate_pair(contact, p.bodies, uncertain, e_n=p.e_n, v_0=p.v_0)
        for name, p in pairs.items()
        if uncertain
    }
    for name, spread in spreads.items():
        result[name]["uncertain"] = spread.to_dict()
    text = case_block(scene, block.style, steps)
    if json:
        show.as_json({"case": scene.name, "method": contact.method, "pairs": result, "liggghts": text})
        return
    if many:
        print_many(scene.name, contact.method, result)
    for name, data in result.items() if not many else ():
        _kn_print_pair(name, data, contact.method)
        if name in spreads:
            show.say()
            print_propagation(f"{name}, {contact.method}", spreads[name])
    _say_block(block.style, text)


def _beside_the_normal(scene: Scene, p: _CasePair) -> dict[str, dict[str, float | None]]:
    """What friction and cohesion make of a contact, by model; nothing of a pair that has neither."""
    from kncal.core.errors import CaseFileError, ValidityError
    from kncal.scene.model import KINDS
    from kncal.scene.pair_contact import bond_number
    from kncal.scene.plan import contact_of, speed_once

    found: dict[str, dict[str, float | None]] = {}
    for kind in KINDS:
        with suppress(CaseFileError, ValidityError):  # the table says what the pair lacks
            c = contact_of(scene, *p.bodies, kind, speed_once(), 0.0)
            row = {"c_t": c.c_t, "e_t": c.stick_restitution()} if c.friction > 0.0 else {}
            sticky = {"cohesion_energy_density": c.cohesion, "bond_number": bond_number(c, p.bodies, scene.g)}
            if row := row | (sticky if c.cohesion > 0.0 else {}):
                found[kind] = row
    return found


def _say_block(what: str, block: str) -> None:
    show.say(f"For a LIGGGHTS deck ({what}):\n")
    if len(block) > _LONG_BLOCK:
        show.say(f'{len(block) // 1024} kB, too long for a terminal: --json prints it, under "liggghts"')
    else:
        show.say(block)


def _prescribed(contact: ContactChoice, p: _CasePair, steps: float) -> dict[str, Any]:
    """Return the row of a prescribed k_n: its damping, duration and time step; overlaps where a speed is known."""
    from kncal.core.errors import ValidityError
    from kncal.physics.timestep import verlet_limit
    from kncal.scene.pair_contact import PairNumbers, Rest, calibration_for, pair_contact

    numbers = PairNumbers(p.e_n, 0.0, p.v_0, p.k_n)
    try:
        calibration = calibration_for(contact, p.pair, numbers)
    except ValidityError as error:
        return {"method": "prescribed", "problem": str(error)}
    if calibration is not None:
        row = row_of(calibration, steps)
        del row["reference"]
        return row | {"method": "prescribed", "k_n": p.k_n}
    c = pair_contact(contact, p.pair, numbers, "linear", Rest(0.0, 0.0), scene="", names=p.name)
    return {
        "method": "prescribed",
        **dict.fromkeys(("kappa", "delta_max", "delta_mean", "delta_end", "dt_hertz")),
        "k_n": c.k,
        "eta_n": c.c,
        "gamma_n": c.c / c.m_eff,
        "t_c": c.t_c,
        "dt": c.t_c / steps,
        "dt_limit": float(verlet_limit(c.k, c.m_eff, c.c, 12.0)),
        "warnings": [],
    }


def _kn_print_pair(name: str, data: dict[str, Any], method: str) -> None:
    if data["pairs_of_bodies"] > 1:
        show.say(f"{name} stands for {data['pairs_of_bodies']} pairs of bodies that are alike:")
    kn_print(name, data)
    for kind, row in data["contacts"].items():
        known = ", ".join(f"{key} = {value:.4g}" for key, value in row.items() if value is not None)
        show.say(f"  {kind}: {known}")
    if data["v_0"] is None:
        show.say(f"{name}: the case has no impact speed to calibrate at (contact.v_0 sets one)")
    if data["k_n_prescribed"] is not None:
        show.say(f"{name}: the case prescribes k_n = {show.quantity(data['k_n_prescribed'], 'N/m')}")
    else:
        show.say(f"{name}: the case uses the method {method}")


def collide(
    *,
    contact: ContactFlags = ContactFlags(),
    how: MethodFlags = MethodFlags(),
    out: Annotated[Path, Parameter(help="picture to write (.png or .svg)")] = Path("collide.png"),
    json: Json = False,
) -> None:
    """Solve one impact exactly, with the reference law and with its linear equivalent, and draw both.

    Example: kncal collide --young 70e9 --density 2500 --radius 1e-3 --v0 0.5 --en 0.7 --against wall
    """
    from kncal.physics.calibration import calibrate
    from kncal.report.collision import plot_collision

    own = how.own()
    taken = ["--method", *(f"--{name.replace('_', '-')}" for name in own)]
    refuse_ignored(f"the method {how.method}", [flag for flag in how.given() if flag not in taken])
    pair, speed, restitution = contact.pair(), contact.speed(), contact.restitution()
    calibration = calibrate(
        pair, v_0=speed, e_n=restitution, law=contact.law, method=how.method, end=contact.end, **own
    )
    plot_collision(calibration, out)
    data = calibration.to_dict()
    if json:
        show.as_json(data | {"picture": str(out)})
        return
    rows = [
        [name, show.quantity(data["reference"][name], unit), show.quantity(data[name], unit)]
        for name, unit in (("t_c", "s"), ("delta_max", "m"), ("delta_mean", "m"), ("delta_end", "m"))
    ]
    rows.append(["stiffness", show.quantity(float(pair.k_h), "N/m^1.5"), show.quantity(data["k_n"], "N/m")])
    title = f"{contact.title}: one impact at {data['v_0']:g} m/s, e_n = {data['e_n']:g}"
    show.table(title, ["", contact.law, f"linear ({how.method})"], rows)
    for warning in data["warnings"]:
        show.say(f"  {show.kind_of(warning['code'])}: {warning['message']}")
    show.say(f"picture: {out}")

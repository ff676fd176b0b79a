"""Gas by the real DPMFoam, restarted for every step: its forces against independent physics."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import gas_columns as columns
import numpy as np
import pytest
from gas_columns import MU, RHO_G, D, G

from kncal.core.checks import Array
from kncal.core.errors import ReadError, RunError, SolverMissingError
from kncal.engines.base import GasSetup, GasSolver
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.dpmfoam.restart import RestartGas
from kncal.record.openfoam import read_cells
from kncal.record.steps import GasStep
from kncal.scene.gas import Jet

pytestmark = columns.needs_openfoam
NOBODY = np.zeros((0, 3))


def hold(gas: GasSolver, x: Array, steps: int) -> GasStep:
    """Frozen particles for some steps; every step's balances are checked."""
    for _ in range(steps):
        step = gas.step(x, 0 * x, *columns.alike(x))
        check_balances(step, columns.weight(x))
    return step


def check_balances(step: GasStep, weight: float) -> None:
    assert step.reaction_error <= 1e-10 * weight
    assert step.not_passed <= 1e-3 * weight
    assert step.solids_error <= 1e-12


def gidaspow(eps: Array, slip: Array, d: Array) -> Array:
    """Drag per volume and slip, model B: the textbook's beta over eps (1 - eps), with Schiller and Naumann's curve."""
    Re = eps * RHO_G * slip * d / MU
    C_d = np.where(Re < 1000.0, 24.0 / Re * (1.0 + 0.15 * Re**0.687), 0.44)
    ergun = 150.0 * (1 - eps) ** 2 * MU / (eps * d**2) + 1.75 * (1 - eps) * RHO_G * slip / d
    wen_yu = 0.75 * C_d * eps * (1 - eps) * RHO_G * slip / d * eps**-2.65
    return np.where(eps < 0.8, ergun, wen_yu) / (eps * (1.0 - eps))


def du_plessis(eps: Array, slip: Array, d: Array) -> Array:
    """Drag per volume and slip of du Plessis and Masliyah's A and B."""
    s = (1.0 - eps) ** (1.0 / 3.0)
    A = 26.8 * eps**3 / (s**2 * (1 - s) * (1 - s**2) ** 2)
    B = eps**2 / (1 - s**2) ** 2
    return (A * (1 - eps) / eps + B * RHO_G * slip * d / MU) * MU / (eps * d**2)


@pytest.mark.parametrize(("drag", "law"), [("ErgunWenYu", gidaspow), ("PlessisMasliyah", du_plessis)])
def test_drag_identity(drag: str, law: Callable[[Array, Array, Array], Array], tmp_path: Path) -> None:
    """Two particles a cell, each with force m k ((U_old - u)/(1 + k dt) + U_new - U_old) + buoyancy, k by the law."""
    n, h, dt = 24, 4e-3, 1e-5
    gas = RestartGas(columns.setup((2, 1, n), h, inlet=0.5, step=dt, drag=drag), tmp_path / "gas")
    k, i, small = (index.ravel() for index in np.meshgrid(np.arange(n), [0, 1], [0, 1], indexing="ij"))
    eps = np.linspace(0.3, 0.999, n)[k]
    ratio = 0.4  # of the diameters
    d = np.cbrt((1.0 - eps) * h**3 * 6.0 / np.pi / (1.0 + ratio**3)) * np.where(small, ratio, 1.0)
    x = (np.stack([i, 0 * i, k], axis=1) + 0.5) * h + 0.3 * h * small[:, None]
    v = np.zeros_like(x)
    v[:, 2] = 0.5 / eps - np.geomspace(0.01, 40.0, len(x)) * (-1.0) ** i  # slips to either side
    v[:, 0] = np.where(small, 0.3, 0.1)
    rho = np.where(small, 2.0, 1.0) * columns.RHO
    gas.step(x, 0 * x, d, rho)  # brings the gas to the velocities of continuity
    before = gas.fields().U[k, 0, i]
    force = gas.step(x, v, d, rho).force
    after, found = gas.fields().U[k, 0, i], gas.fields().eps_g[k, 0, i]
    assert found == pytest.approx(eps, abs=1e-14)
    assert np.linalg.norm(after - before, axis=1).max() > 0.01
    slip = np.linalg.norm(before - v, axis=1)
    assert slip.min() < 0.4 and slip.max() > 35.0
    volume = np.pi / 6.0 * d**3
    rate = law(eps, slip, d) / rho
    expected = (rho * volume * rate)[:, None] * ((before - v) / (1.0 + rate * dt)[:, None] + after - before)
    expected[:, 2] += volume * RHO_G * G
    error = np.linalg.norm(force - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert error.max() < 1e-9


def test_packed_bed_pressure_gradient_is_ergun(quick: Callable[[GasSetup], GasSolver]) -> None:
    """Local Ergun with each cell's own void fraction and velocity, and the balance of the whole column."""
    setup = columns.setup((5, 3, 15), 2.6e-3, inlet=0.1, step=1e-3)
    x = columns.packing((setup.size[0], setup.size[1], 12 * 2.6e-3), 1)
    x = x[np.random.default_rng(1).random(len(x)) < 0.9]  # holes at random: void fractions as uneven as in a bed
    gas = quick(setup)
    area, height = setup.size[0] * setup.size[1], setup.size[2]
    for U_0 in (0.1, 0.3, 0.6):
        gas.set_inlet(U_0)
        step = hold(gas, x, 8)
        fields = gas.fields()
        eps, U = fields.eps_g[1:11], fields.U[1:11]
        assert eps.max() < 0.8  # inside the bed: all of it in Ergun's range
        # Continuity holds for the fluxes through faces; the velocities of cells follow within their differences.
        assert float((eps * U[..., 2]).mean()) == pytest.approx(U_0, rel=0.02)
        u, speed = eps * U[..., 2], eps * np.linalg.norm(U, axis=-1)
        viscous = 150.0 * (1 - eps) ** 2 / eps**3 * MU / D**2
        ergun = (viscous + 1.75 * (1 - eps) / eps**3 * RHO_G * speed / D) * u
        planes = fields.p[1:11].mean(axis=(1, 2))
        drop = planes[0] - planes[-1]
        h = setup.size[2] / setup.cells[2]
        per_plane = ergun.mean(axis=(1, 2)) * h
        expected = per_plane[1:-1].sum() + 0.5 * (per_plane[0] + per_plane[-1]) + RHO_G * G * 9 * h
        assert drop == pytest.approx(expected, rel=0.01)
        # Inlet pressure carries the drag, the weight of a column of gas without particles, and the change of momentum
        drag = step.force[:, 2].sum() - len(x) * columns.VOLUME * RHO_G * G
        momentum = RHO_G * U_0**2 * (1.0 - float((1.0 / fields.eps_g[0]).mean())) * area
        assert step.p_in * area == pytest.approx(drag + RHO_G * G * area * height + momentum, rel=1e-3)


def test_gas_alone_is_hydrostatic(tmp_path: Path) -> None:
    setup = columns.setup((3, 2, 10), inlet=0.7)
    gas = RestartGas(setup, tmp_path / "gas")
    for _ in range(2):
        step = gas.step(NOBODY, NOBODY, np.zeros(0), np.zeros(0))
    height = setup.size[2]
    assert step.force.shape == (0, 3)
    assert step.p_in == pytest.approx(RHO_G * G * height, rel=1e-5)
    z = (np.arange(10) + 0.5) * height / 10
    assert gas.fields().p == pytest.approx(
        np.broadcast_to((RHO_G * G * (height - z))[:, None, None], (10, 2, 3)), rel=1e-4
    )
    assert gas.fields().U[..., 2] == pytest.approx(np.full((10, 2, 3), 0.7), rel=1e-4)
    assert step.courant_max == pytest.approx(0.7 * setup.step / 3e-3, rel=1e-4)
    assert (step.reaction_error, step.not_passed, step.solids_error, step.eps_g_min) == (0.0, 0.0, 0.0, 1.0)


def test_terminal_velocity(quick: Callable[[GasSetup], GasSolver]) -> None:
    """A particle at its terminal velocity weighs nothing more; one held in the gas, one falling through the cells."""
    density, sizes = 500.0, np.array([0.3e-3, 0.2e-3])
    volume = np.pi / 6.0 * sizes**3

    def excess(speed: Array) -> Array:
        return gidaspow(np.full(2, 1.0 - 1e-12), speed, sizes) * speed - (density - RHO_G) * G

    low, high = np.full(2, 1e-6), np.full(2, 10.0)
    for _ in range(60):  # bisection of the force balance: independent of the package
        middle = 0.5 * (low + high)
        low, high = np.where(excess(middle) < 0.0, middle, low), np.where(excess(middle) < 0.0, high, middle)
    falling, held = 0.5 * (low + high)[1], 0.5 * (low + high)[0]
    setup = columns.setup((8, 4, 12), 5e-3, inlet=float(held), step=2.5e-4)  # < 1 % of the relaxation times
    gas = quick(setup)
    x = np.array([[7.5e-3, 7.5e-3, 32.5e-3], [32.5e-3, 12.5e-3, 22.5e-3]])
    v = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, held - falling]])
    forces = []
    for _ in range(36):
        step = gas.step(x, v, sizes, np.full(2, density))
        check_balances(step, float(density * volume.sum() * G))
        forces.append(step.force[:, 2])
        x = x + v * setup.step
    # Steady in the last third; 1 % of force is less than 1 % of velocity
    assert np.mean(forces[24:], axis=0) == pytest.approx(density * volume * G, rel=0.01)


def test_settling_follows_the_equation_of_motion(quick: Callable[[GasSetup], GasSolver]) -> None:
    d, density, dt = 0.5e-3, 1000.0, 5e-3
    setup = columns.setup((4, 4, 16), 1e-2, inlet=0.0, step=dt)
    gas = quick(setup)
    mass = density * np.pi / 6.0 * d**3
    x, v = np.array([[0.015, 0.015, 0.15]]), np.zeros((1, 3))
    for _ in range(20):
        force = gas.step(x, v, np.array([d]), np.array([density])).force
        a = force / mass - [0.0, 0.0, G]
        x, v = x + v * dt + 0.5 * a * dt**2, v + a * dt
    u, fallen, fine = 0.0, 0.0, 1e-5
    for _ in range(round(20 * dt / fine)):  # midpoint rule of the same equation, fine enough to be exact here
        middle = u + 0.5 * fine * acceleration(u, d, density)
        u, fallen = u + fine * acceleration(middle, d, density), fallen + fine * middle
    assert u < 0.95 * G * 20 * dt  # drag matters
    assert -v[0, 2] == pytest.approx(u, rel=0.01)
    assert 0.15 - x[0, 2] == pytest.approx(fallen, rel=0.01)


def acceleration(u: float, d: float, density: float) -> float:
    """Downward acceleration of a single sphere that falls with ``u`` in still gas [m/s²]."""
    drag = float(gidaspow(np.array(1.0 - 1e-12), np.array(max(u, 1e-9)), np.array(d))) * u
    return ((density - RHO_G) * G - drag) / density


@pytest.mark.parametrize("count", [1, 8, 27])
def test_balances_of_a_moving_bed(count: int, tmp_path: Path) -> None:
    """Fast particles in every direction, against walls, too: no momentum is lost, no parcel bounces or leaves."""
    setup = columns.setup((5, 2, 10), parcels_per_particle=count, step=2e-4)
    x = columns.packing((setup.size[0], setup.size[1], 0.03), pitch=1.3 * D)
    rng = np.random.default_rng(5)
    gas = RestartGas(setup, tmp_path / "gas")
    for _ in range(3):
        v = rng.normal(0.0, 1.0, x.shape)
        step = gas.step(x, v, *columns.alike(x))
        check_balances(step, columns.weight(x))
    assert step.not_passed > 0.0
    x, v = x[: len(x) // 2], v[: len(x) // 2]  # the number of particles may change
    check_balances(gas.step(x, v, *columns.alike(x)), columns.weight(x))


@pytest.mark.parametrize("speed", [-0.5, 0.4])
def test_what_particles_displace_flows_around_them(speed: float, tmp_path: Path) -> None:
    """A bed that moves as one: through a plane flows what enters below, less what the voids there have gained."""
    setup = columns.setup((5, 2, 15), 2.6e-3, inlet=0.3)
    x = columns.packing((setup.size[0], setup.size[1], 12 * 2.6e-3)) + np.array([0.0, 0.0, 3e-3])
    x[:, 2] += np.random.default_rng(0).uniform(-0.5, 0.5, len(x)) * 1.3e-3  # no rows that change cells together
    gas = RestartGas(setup, tmp_path / "gas")
    v = np.tile([0.0, 0.0, speed], (len(x), 1))
    voids = []
    for _ in range(3):
        check_balances(gas.step(x, v, *columns.alike(x)), columns.weight(x))
        voids.append(gas.fields().eps_g.mean(axis=(1, 2)))
        x = x + v * setup.step
    fields = gas.fields()
    gained = np.cumsum(voids[-1] - voids[-2]) * 2.6e-3 / setup.step
    faces = 0.3 - np.concatenate([[0.0], gained])
    expected = (0.5 * (faces[1:] + faces[:-1]))[3:11].mean()  # planes inside the bed
    assert abs(expected - 0.3) > 0.1  # the displacement is no detail
    assert (fields.eps_g * fields.U[..., 2])[3:11].mean() == pytest.approx(expected, abs=0.01)


def test_satellites_smooth_the_void_fraction(tmp_path: Path) -> None:
    x = columns.packing((0.015, 0.006, 0.03))
    spread = {}
    for count in (1, 27):
        gas = RestartGas(columns.setup((5, 2, 15), parcels_per_particle=count), tmp_path / f"gas{count}")
        hold(gas, x, 1)
        spread[count] = float(gas.fields().eps_g[1:8].std())
    assert spread[27] < 0.7 * spread[1]


def test_depths(tmp_path: Path) -> None:
    """A periodic column does not care where its period begins; a layer has no force out of its plane."""
    x = columns.packing((0.009, 0.012, 0.03), 3)
    x = x[np.random.default_rng(0).random(len(x)) < 0.8]  # holes, so that the gas goes around
    periodic = columns.setup((3, 4, 15), front_back="periodic", step=1e-3)
    moved = x + np.array([0.0, 3e-3, 0.0])
    moved[::2, 1] -= 12e-3  # images of the same particles
    force = [hold(RestartGas(periodic, tmp_path / f"p{i}"), y, 3).force for i, y in enumerate((x, moved))]
    scale = np.abs(force[0]).max()
    assert np.abs(force[1] - force[0]).max() < 1e-5 * scale
    assert np.abs(force[0][:, 1]).max() > 1e-4 * scale

    flat = columns.packing((0.015, 1.08 * D, 0.03), 3)
    flat[:, 1] = 0.6e-3
    layer = columns.setup((5, 1, 15), size=(0.015, D, 0.045), front_back="layer", step=1e-3)
    step = hold(RestartGas(layer, tmp_path / "layer"), flat, 3)
    assert (step.force[:, 1] == 0.0).all()
    assert (step.force[:, 2] > 0.0).all()


@pytest.mark.parametrize("walls", ["slip", "noSlip"])
def test_jet(walls: str, tmp_path: Path) -> None:
    """A jet in the middle: what enters by the slot leaves at the top, and the forces are as symmetric as the bed."""
    jet = Jet(x_low=6e-3, x_high=9e-3, velocity=2.0)
    setup = columns.setup((5, 1, 15), jet=jet, inlet=0.0, walls=walls, front_back="layer", step=5e-4)
    half = columns.packing((0.0075, 0.003, 0.024))
    x = np.concatenate([half, half * [-1.0, 1.0, 1.0] + [0.015, 0.0, 0.0]])
    gas = RestartGas(setup, tmp_path / "gas")
    step = hold(gas, x, 4)
    n = len(half)
    scale = np.abs(step.force).max()
    assert step.force[n:] * [-1.0, 1.0, 1.0] == pytest.approx(step.force[:n], abs=1e-5 * scale)
    top = gas.fields()
    assert float((top.eps_g * top.U[..., 2])[-1].mean()) == pytest.approx(2.0 / 5, rel=1e-2)
    bottom = top.U[0, 0, :, 2]
    assert bottom[2] > 3.0 * max(bottom[0], bottom[4])
    gas.set_inlet(1.0)
    hold(gas, x, 2)
    top = gas.fields()
    assert float((top.eps_g * top.U[..., 2])[-1].mean()) == pytest.approx(1.0 / 5, rel=1e-2)


def test_a_saved_state_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    setup = columns.setup((5, 2, 15), inlet=1.0 / 3.0)
    x = columns.packing((0.015, 0.006, 0.03), 4)
    v = np.random.default_rng(1).normal(0.0, 0.3, x.shape)

    def steps(gas: RestartGas, first: int, last: int) -> list[GasStep]:
        return [gas.step(x + number * 1e-5, v, *columns.alike(x)) for number in range(first, last)]

    whole = RestartGas(setup, tmp_path / "whole")
    steps(whole, 0, 2)
    whole.save(tmp_path / "state")
    later = steps(whole, 2, 4)
    again = RestartGas(setup, tmp_path / "again")
    again.load(tmp_path / "state")
    for one, two in zip(later, steps(again, 2, 4), strict=True):
        assert np.array_equal(one.force, two.force)
        assert (one.p_in, one.not_passed) == (two.p_in, two.not_passed)
    assert whole.cpu_seconds > 0.0
    with pytest.raises(RunError, match="before the first gas step"):
        again.load(tmp_path / "state")


def test_states_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    gas = RestartGas(columns.setup((3, 1, 5)), tmp_path / "gas")
    with pytest.raises(RunError, match="no gas state to save"):
        gas.save(tmp_path / "state")
    with pytest.raises(RunError, match="no gas fields"):
        gas.fields()
    with pytest.raises(ReadError, match=r"no U\.air"):
        gas.load(tmp_path / "state")
    gas.step(NOBODY, NOBODY, np.zeros(0), np.zeros(0))
    gas.save(tmp_path / "state")
    other = RestartGas(columns.setup((3, 1, 6)), tmp_path / "other")
    with pytest.raises(ReadError, match="15 values, expected 18"):
        other.load(tmp_path / "state")
    gas.close()
    gas.close()
    with pytest.raises(RunError, match="closed"):
        gas.step(NOBODY, NOBODY, np.zeros(0), np.zeros(0))


def test_failures_speak_with_the_solver_s_own_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gas = RestartGas(columns.setup((3, 1, 5)), tmp_path / "gas")
    field = tmp_path / "gas" / "0" / "p"
    text = field.read_bytes()
    field.write_bytes(text[: len(text) // 2])
    with pytest.raises(RunError, match=r"(?s)exit code 1: --> FOAM FATAL IO ERROR.*0/p.*see .*log\.DPMFoam"):
        gas.step(NOBODY, NOBODY, np.zeros(0), np.zeros(0))
    slow = RestartGas(columns.setup((3, 1, 5)), tmp_path / "slow", time_limit=0.02)
    with pytest.raises(RunError, match="time limit"):
        slow.step(NOBODY, NOBODY, np.zeros(0), np.zeros(0))
    wild = RestartGas(columns.setup((3, 1, 5)), tmp_path / "wild")
    field = tmp_path / "wild" / "0" / "U.air"
    field.write_text(field.read_text().replace("internalField uniform (0 0 0.3)", "internalField uniform (0 0 1e200)"))
    with pytest.raises(RunError, match=r"signal 8 .*diverged"):
        wild.step(NOBODY, NOBODY, np.zeros(0), np.zeros(0))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SolverMissingError, match="apt-get install openfoam"):
        RestartGas(columns.setup(), tmp_path / "missing")


def test_a_case_runs_by_hand_and_channel_flow_is_poiseuille(tmp_path: Path) -> None:
    """Gas alone between no-slip walls: dp/dz = -12 mu U/W² - rho g, and a parabola."""
    n, width, mu, U = 16, 0.01, 2e-3, 0.2
    setup = columns.setup(
        (n, 1, 12), size=(width, 1e-3, 0.03), inlet=U, viscosity=mu, walls="noSlip", front_back="layer", step=1e-3
    )
    folder = tmp_path / "channel"
    write_case(setup, folder, end_time=0.15, write_interval=150)
    done = subprocess.run([folder / "Allrun"], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    p = RHO_G * read_cells(folder / "0.15" / "p", 12 * n).reshape(12, n).mean(axis=1)
    h = 0.03 / 12
    gradient = (p[10] - p[5]) / (5 * h)
    assert gradient == pytest.approx(-12.0 * mu * U / width**2 - RHO_G * G, rel=0.01)
    mesh = columns.read_case(folder)["internalMesh"]
    x = mesh.cell_centers().points
    row = np.abs(x[:, 2] - 8.5 * h) < 1e-6
    s = x[row, 0] / width
    assert mesh.cell_data["U.air"][row, 2] == pytest.approx(6.0 * U * s * (1.0 - s), abs=0.015 * U)

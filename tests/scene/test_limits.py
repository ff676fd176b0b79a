"""What a bed can't do is found before the run: each limit fires on its side of its bound, and nowhere else."""

import math
from dataclasses import replace

import numpy as np
import pytest
from shipped import BEDS

from kncal.core.errors import CaseFileError
from kncal.physics.fluidization import minimum_fluidization_velocity, terminal_velocity
from kncal.scene.case_file import load_case
from kncal.scene.finding import Finding, require_possible
from kncal.scene.gas import Jet
from kncal.scene.limits import check, findings_of
from kncal.scene.load import EPS_SETTLED, largest_superficial, settled_height, settled_voidage
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

MINI = load_case("bubbling_bed_mini")
JET = load_case("bubbling_bed")
ONE = load_case("terminal_velocity_intermediate")


def found(bed: Scene, positions=None) -> dict[str, str]:
    """Code -> level of every finding for the linear model."""
    return {f.code: f.level for f in check(plan(bed, ["linear"])["linear"], positions)}


def message(bed: Scene, code: str) -> str:
    return next(f.message for f in check(plan(bed, ["linear"])["linear"]) if f.code == code)


def change(bed: Scene, part: str, **values) -> Scene:
    if part == "group":
        return bed.with_group(**values)
    if part == "box":
        sides = zip(("width", "depth", "height"), bed.box.size, strict=True)
        bed = bed.with_box(size=tuple(values.pop(name, size) for name, size in sides))
        return change(bed, "gas", **values) if values else bed
    return replace(bed, **{part: replace(getattr(bed, part), **values)})


@pytest.mark.parametrize("name", BEDS)
def test_shipped_beds_are_possible(name):
    """Nothing is refused; the jet bed's Courant number just above 1 is known and said in its README."""
    for model in plan(load_case(name)).values():
        findings = check(model)
        assert {(f.code, f.level) for f in findings} <= ({("courant", "warn")} if name == "bubbling_bed" else set())
        require_possible(findings)


def test_refusals_come_first_and_are_raised_together():
    bad = change(change(MINI, "gas", cells=(40, 2, 30)), "run", coupling=9e-3)
    findings = check(plan(bad)["linear"])
    levels = [f.level for f in findings]
    assert levels == sorted(levels, key=["refuse", "warn"].index)
    refused = [f for f in findings if f.level == "refuse"]
    assert len(refused) >= 2
    with pytest.raises(CaseFileError) as caught:
        require_possible(findings)
    assert str(caught.value).splitlines() == [f.message for f in refused]
    require_possible([f for f in findings if f.level == "warn"])
    assert str(Finding("x", "warn", "text")) == "warn: text"


@pytest.mark.parametrize(
    ("cells", "level"),
    [
        ((10, 2, 30), None),
        ((11, 2, 30), "warn"),
        ((25, 5, 75), "warn"),
        ((26, 5, 75), "refuse"),
        ((10, 6, 30), "refuse"),
    ],
)
def test_gas_cells_against_the_particle(cells, level):
    """Edges of 2.5, 2.27, 1.0, 0.96 and 0.83 diameters."""
    assert found(change(MINI, "gas", cells=cells)).get("cell-size") == level


def test_satellite_parcels_allow_finer_cells_down_to_a_particle():
    fine = change(change(MINI, "gas", cells=(20, 4, 60)), "gas", parcels_per_particle=8)
    assert "cell-size" not in found(fine)
    assert found(change(fine, "gas", cells=(40, 4, 60)))["cell-size"] == "refuse"


@pytest.mark.parametrize(
    ("cells", "code"),
    [
        ((1, 1, 1), "cell-single"),
        ((1, 2, 30), "cell-single"),
        ((10, 1, 30), None),  # the narrow side: a pseudo-two-dimensional bed
        ((4, 1, 30), None),  # 6.25 diameters, a quarter of the width
        ((3, 1, 30), "cell-coarse"),  # 8.3 diameters
        ((10, 2, 15), None),  # 5 diameters, 0.24 of the bed at rest, which is 25.1 mm high
        ((10, 2, 14), "cell-coarse"),
        ((10, 2, 9), "cell-coarse"),  # 8.3 diameters
    ],
)
def test_gas_cells_against_the_bed(cells, code):
    levels = found(change(MINI, "gas", cells=cells))
    assert {c for c in levels if c in ("cell-single", "cell-coarse")} == ({code} if code else set())
    assert levels.get("cell-single", "refuse") == "refuse"
    assert levels.get("cell-coarse", "warn") == "warn"


def test_large_gas_cells_are_right_for_one_particle_and_across_a_held_bed():
    assert not set(found(change(ONE, "gas", cells=(1, 1, 1)))) & {"cell-single", "cell-coarse"}
    held = change(change(MINI, "group", frozen=True), "gas", cells=(1, 1, 30))
    assert found(held).get("cell-single") is None
    turned = change(MINI, "box", width=0.006, depth=0.03, cells=(2, 1, 30))
    assert found(turned)["cell-single"] == "refuse"
    narrow = change(MINI, "box", width=0.0059, cells=(1, 1, 30))  # no room for two cells of 2.5 diameters
    assert "cell-single" not in found(change(narrow, "box", depth=0.0059, height=0.5, cells=(1, 1, 160)))


def test_added_mass_of_a_liquid():
    heavy = change(MINI, "gas", density=51.0)  # of 1000
    assert found(heavy)["added-mass"] == "warn"
    assert "added-mass" not in found(change(MINI, "gas", density=49.0))
    assert "added-mass" not in found(change(heavy, "group", frozen=True))
    assert found(change(ONE, "gas", density=0.06 * ONE.density))["added-mass"] == "warn"


def test_gas_that_would_be_compressed():
    fast = change(change(MINI, "group", count=0), "gas", U_0=101.0)
    assert found(fast)["gas-fast"] == "warn"
    assert "gas-fast" not in found(change(fast, "gas", U_0=99.0))


def test_drag_on_held_particles_in_a_long_gas_step():
    """Measured: 0.812 of Ergun's gradient at 0.5 ms, 0.990 at 0.02 ms, at a void fraction of 0.422."""
    held = change(load_case("packed_bed"), "gas", density=10.0, viscosity=1.5e-3, ramp=((0.0, 0.01), (0.04, 0.01)))
    assert found(held)["held-drag"] == "warn"
    for run, ratio in ({"coupling": 5e-4}, 0.812), ({"coupling": 5e-4, "gas_step": 2e-5}, 0.990):
        text = message(change(held, "run", **run), "held-drag")
        told = 1.0 / float(text.partition("divided by about ")[2].split(",")[0])
        assert told == pytest.approx(ratio, abs=0.2 * (1.0 - ratio) + 0.002)  # the void fraction is not known yet
    named = float(message(held, "held-drag").partition("run.gas_step = ")[2].split()[0])
    assert "held-drag" not in found(change(held, "run", gas_step=0.99 * named))
    assert "held-drag" not in found(load_case("packed_bed"))
    assert "held-drag" not in found(change(held, "group", frozen=False))


def test_the_depth_of_a_layer_is_no_cell_size():
    assert "cell-size" not in found(JET)
    assert found(change(JET, "gas", cells=(15, 1, 300)))["cell-size"] == "refuse"


def test_courant_number_of_the_jet_is_that_of_a_run():
    """Measured in runs of this bed: about 1.06 at the largest, at 4.947e-4 s."""
    assert "about 1.04" in message(JET, "courant")
    slow = change(JET, "gas", jet=Jet(x_low=0.07, x_high=0.08, velocity=40.0))
    assert "courant" not in found(slow)
    assert found(change(JET, "run", coupling=9.9e-4))["courant"] == "refuse"
    # half the speed on half the cell size is the same
    half = change(change(JET, "gas", jet=Jet(x_low=0.07, x_high=0.08, velocity=21.0)), "gas", cells=(15, 1, 90))
    assert message(half, "courant").partition("from")[0] == message(JET, "courant").partition("from")[0]


def test_the_gas_step_that_a_message_names_would_do():
    jet = message(JET, "courant")
    named = float(jet.rpartition("run.gas_step = ")[2].split()[0])
    assert "courant" not in found(change(JET, "run", gas_step=0.99 * named))
    assert "courant" not in found(change(JET, "run", coupling=0.99 * named))
    # the drag is held during the coupling interval, however short the gas step
    lazy = change(JET, "run", coupling=9e-3)
    assert found(lazy)["relaxation"] == found(change(lazy, "run", gas_step=1e-4))["relaxation"]


def test_interval_against_the_relaxation_time():
    """A single sphere, where the relaxation time is terminal velocity over g less buoyancy."""
    p, gas = ONE.group, ONE.gas
    assert gas is not None
    fall = terminal_velocity(p.diameter, ONE.density, gas.density, gas.viscosity)
    tau = fall / (9.81 * (1.0 - gas.density / ONE.density))
    for share, level in ((0.0098, None), (0.0102, "warn"), (0.196, "warn"), (0.204, "refuse")):
        bed = change(ONE, "run", coupling=share * tau, until_time=2.0, steps_per_contact=200.0)
        assert found(bed).get("relaxation") == level, share
    assert "about 1 % too small" in message(change(ONE, "run", coupling=0.0102 * tau), "relaxation")
    assert "relaxation" not in found(change(change(ONE, "run", coupling=0.1 * tau), "group", frozen=True))


def test_way_of_a_particle_per_interval():
    # contact.v_0 of 1.2 m/s: half a diameter of 1.2 mm takes 0.5 ms
    fast = replace(MINI, contact=replace(MINI.contact, v_0=1.2, k_n=None))
    assert "particle-way" not in found(change(fast, "run", coupling=4.9e-4))
    assert found(change(fast, "run", coupling=5.4e-4))["particle-way"] == "warn"
    assert found(change(fast, "run", coupling=1.1e-3))["particle-way"] == "refuse"


def test_steps_per_contact():
    assert "dem-step" not in found(change(MINI, "run", steps_per_contact=20.0))
    few = change(MINI, "run", steps_per_contact=12.0)
    assert found(few)["dem-step"] == "warn"
    assert "e_n is up to" in message(few, "dem-step")
    # 12 contacts per particle: omega dt < 2/sqrt(12), so t_c/dt > pi sqrt(12)/2 = 5.4
    assert found(change(MINI, "run", steps_per_contact=5.0))["dem-step"] == "refuse"
    assert found(change(MINI, "run", steps_per_contact=6.5))["dem-step"] == "warn"


def test_a_lone_particle_needs_no_step_for_twelve_contacts():
    """It touches three walls at most, in a corner: omega dt < 2/sqrt(3), t_c/dt > 2.72; a case has 4 at least."""
    few = change(ONE, "run", steps_per_contact=4.0)
    assert found(few)["dem-step"] == "warn"
    texts = [f.message for f in check(plan(few, ["linear"])["linear"]) if f.code == "dem-step"]
    assert len(texts) == 1  # of the walls; a lone particle meets no other
    two = change(few, "group", position=None, positions=((0.001, 0.001, 0.01), (0.001, 0.001, 0.02)))
    assert found(two)["dem-step"] == "warn"
    assert found(change(MINI, "run", steps_per_contact=4.0))["dem-step"] == "refuse"


def test_gas_below_u_mf_is_flagged():
    gas = MINI.gas
    assert gas is not None
    U_mf = minimum_fluidization_velocity(1.2e-3, 1000.0, gas.density, gas.viscosity, EPS_SETTLED)
    assert found(change(MINI, "gas", U_0=0.99 * U_mf))["below-u-mf"] == "warn"
    assert "below-u-mf" not in found(change(MINI, "gas", U_0=1.01 * U_mf))
    assert "below-u-mf" not in found(change(change(MINI, "gas", U_0=0.1), "group", frozen=True))
    assert "below-u-mf" not in found(change(MINI, "gas", U_0=0.0, ramp=((0.0, 0.1), (1.0, 1.1 * U_mf))))
    thin = change(JET, "gas", jet=Jet(x_low=0.07, x_high=0.08, velocity=20.0))  # 1.33 m/s over the width
    assert found(thin)["below-u-mf"] == "warn"


def test_gas_that_carries_the_bed_away_is_flagged():
    assert found(change(MINI, "gas", U_0=5.0))["carried-out"] == "warn"
    assert "carried-out" not in found(change(MINI, "gas", U_0=2.0))


def test_room_for_the_bed():
    H = settled_height(MINI)
    low = tuple((n if i < 2 else 8) for i, n in enumerate(MINI.gas.cells))
    assert found(change(MINI, "box", height=0.99 * H, cells=low))["column-low"] == "refuse"
    assert found(change(MINI, "box", height=1.5 * H, cells=low))["column-low"] == "warn"
    assert "column-low" not in found(MINI)


def test_jet_on_cell_faces():
    off = change(JET, "gas", jet=Jet(x_low=0.07, x_high=0.0775, velocity=42.0))
    assert found(off)["jet-faces"] == "refuse"
    assert "nearest is 0.08" in message(off, "jet-faces")
    assert "jet-faces" not in found(change(off, "gas", cells=(60, 1, 45)))


def test_depth():
    periodic = replace(MINI, periodic=("y",))
    assert found(change(periodic, "box", depth=0.003, cells=(10, 1, 30)))["depth-periodic"] == "refuse"
    assert "depth-periodic" not in found(periodic)
    assert found(replace(JET, layer=None))["depth-one-layer"] == "warn"


def test_gas_or_particles_alone():
    assert found(replace(MINI, gas=None)) == {}
    assert found(change(MINI, "group", count=0)) == {}


# --- positions ------------------------------------------------------------------------------------------------


def lattice(bed: Scene, pitch: float) -> np.ndarray:
    """A simple cubic lattice from wall to wall, layer by layer."""
    d = bed.diameter
    nx, ny = round(bed.box.width / (pitch * d)), round(bed.box.depth / (pitch * d))
    n = math.ceil(bed.number / (nx * ny))
    x = (np.arange(nx) + 0.5) * bed.box.width / nx
    y = (np.arange(ny) + 0.5) * bed.box.depth / ny
    z = (np.arange(n) + 0.5) * pitch * d
    return np.array([(a, b, c) for c in z for a in x for b in y])[: bed.number]


@pytest.mark.parametrize("pitch", [1.0, 1.25])
def test_measured_voidage_is_that_of_the_lattice(pitch):
    x = lattice(MINI, pitch)
    exact = 1.0 - math.pi / 6.0 / pitch**3
    assert settled_voidage(MINI, x) == pytest.approx(exact, abs=0.02)
    assert settled_voidage(ONE, np.zeros((1, 3))) == EPS_SETTLED


def test_measured_voidage_decides_what_fluidises():
    gas = MINI.gas
    assert gas is not None
    U_0 = 1.1 * minimum_fluidization_velocity(1.2e-3, 1000.0, gas.density, gas.viscosity, EPS_SETTLED)
    bed = change(MINI, "gas", U_0=U_0)
    assert "below-u-mf" not in found(bed)
    assert found(bed, lattice(bed, 1.0))["below-u-mf"] == "warn"  # a void fraction of 0.476 lets more gas through


def test_positions_that_are_none():
    x = lattice(MINI, 1.0)
    assert found(MINI, x[:-1])["positions"] == "refuse"
    x[5, 2] = -1e-3
    assert found(MINI, x)["outside"] == "refuse"
    x[5, 2] = np.nan
    assert found(MINI, x)["positions"] == "refuse"
    assert found(MINI, 0.01)["positions"] == "refuse"


def test_superficial_velocity_and_height():
    assert largest_superficial(JET) == pytest.approx(2.8)
    assert largest_superficial(replace(MINI, gas=None)) == 0.0
    assert largest_superficial(load_case("packed_bed")) == 0.6
    # a void fraction of 0 is the solid volume over the area
    assert settled_height(JET, 0.0) * 0.15 * 0.004 == pytest.approx(2400 * math.pi / 6.0 * 0.004**3)


@pytest.mark.parametrize("changes", [{"coupling": 5e-2}, {"coupling": 5e-3, "gas_step": 5e-3}])
def test_what_both_models_have_in_common_is_refused_once(changes):
    scene = replace(MINI, run=replace(MINI.run, **changes))
    both = plan(scene)
    assert both["linear"].coupling != both["hertz"].coupling  # so the numbers in the texts differ
    codes = [f.code for _, f in findings_of(both.values()) if f.code in ("courant", "relaxation", "particle-way")]
    assert codes
    assert len(codes) == len(set(codes))
    assert {f.code for f in check(both["linear"]) if f.level == "refuse"} <= {
        f.code for _, f in findings_of(both.values()) if f.level == "refuse"
    }

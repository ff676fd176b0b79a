"""Packings, contacts and mixtures that are known."""

from __future__ import annotations

import numpy as np
import pytest
from seen_grains import D, grains

from kncal.core.errors import InputError
from kncal.observe.grains import Space
from kncal.observe.mixing import cells_of, mixing_time, mixture
from kncal.observe.packing import anisotropy, backbone, bulk, contacts, fabric

#: Lattice -> places in its cell, solids fraction and number of neighbours of touching spheres, cell over diameter.
LATTICES = {
    "sc": ([(0, 0, 0)], np.pi / 6.0, 6, 1.0),
    "bcc": ([(0, 0, 0), (0.5, 0.5, 0.5)], np.pi * np.sqrt(3.0) / 8.0, 8, 2.0 / np.sqrt(3.0)),
    "fcc": ([(0, 0, 0), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)], np.pi / np.sqrt(18.0), 12, np.sqrt(2.0)),
}


def lattice(name, cells=(10, 10, 10), d=D, closer=1e-4):
    """Particles of a lattice that overlap by a share ``closer`` of their diameter, and their space, all periodic."""
    places, fraction, neighbours, side = LATTICES[name]
    side *= d * (1.0 - closer)
    corners = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), axis=-1).reshape(-1, 1, 3)
    x = ((corners + np.array(places)) * side).reshape(-1, 3)
    high = tuple(float(n * side) for n in cells)
    space = Space(low=(0.0, 0.0, 0.0), high=high, periodic=(True, True, True), up=(0.0, 0.0, 1.0))
    return grains(x, d=d), space, fraction / (1.0 - closer) ** 3, neighbours


@pytest.mark.parametrize("name", LATTICES)
def test_a_lattice_has_its_fraction_and_neighbours(name):
    found, space, fraction, neighbours = lattice(name)
    inside = bulk(found, space, D)
    assert inside.grains.all() and inside.fraction == pytest.approx(fraction, rel=1e-9)
    touching = contacts(found, space)
    carry, number = backbone(touching, ~inside.grains, 4)
    assert carry.all() and (number == neighbours).all()
    assert touching.share == pytest.approx(1e-4, rel=1e-6)
    assert fabric(touching.normal) == pytest.approx(np.eye(3) / 3.0, abs=1e-12)
    assert anisotropy(touching.normal)[0] == 0.0


@pytest.mark.parametrize("name", LATTICES)
def test_the_bulk_of_a_packing_between_walls_and_below_a_surface_has_its_fraction(name):
    found, space, fraction, neighbours = lattice(name, (14, 12, 14))
    high = (space.high[0], space.high[1], 1.6 * space.high[2])  # half as much room above
    box = Space(low=space.low, high=high, periodic=(False, True, False), up=space.up)
    inside = bulk(found, box, D)
    assert inside.fraction == pytest.approx(fraction, rel=0.005)
    assert inside.parts == pytest.approx(fraction, rel=0.01) and len(inside.parts) == 8
    _, number = backbone(contacts(found, box), ~inside.grains, 4)
    assert (number[inside.grains] == neighbours).all()
    assert found.x[inside.grains, 2].max() < space.high[2] - 1.5 * D


def test_rattlers_are_left_out_and_those_that_only_they_hold():
    found, space, _, _ = lattice("sc", (8, 8, 8))
    open_box = Space(low=space.low, high=(space.high[0] + 10 * D,) * 3, periodic=(False,) * 3, up=space.up)
    chain = np.array([[space.high[0] + 3 * D + k * 0.999 * D, 1.0 * D, 1.0 * D] for k in range(4)])  # touches nothing
    both = grains(np.concatenate([found.x, chain]))
    nobody = np.zeros(len(both.x), dtype=bool)
    carry, number = backbone(contacts(both, open_box), nobody, 2)
    assert (~carry).sum() == 4 and not carry[-4:].any()
    assert number[carry].mean() == pytest.approx(2 * 3 * 8 * 8 * 7 / 512)  # the contacts of the cube alone
    assert not backbone(contacts(both, open_box), nobody, 13)[0].any()


def test_contacts_of_unequal_spheres_through_a_periodic_side():
    box = Space(low=(-1.0, 0.0, 0.0), high=(1.0, 1.0, 1.0), periodic=(True, False, False), up=(0.0, 0.0, 1.0))
    pair = grains(
        np.array([[-0.98, 0.5, 0.5], [0.92, 0.5, 0.5], [0.5, 0.02, 0.5], [0.5, 0.98, 0.5]]), d=[0.15, 0.1] * 2
    )
    found = contacts(pair, box)
    assert found.pairs.tolist() == [[0, 1]]  # the other two meet through a side that is not periodic
    assert found.overlap == pytest.approx([0.025]) and found.share == pytest.approx([0.25])
    assert found.normal == pytest.approx(np.array([[-1.0, 0.0, 0.0]]))


def test_anisotropy_is_zero_of_isotropic_normals_in_the_mean_and_right_of_known_ones():
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(20_000, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    value, chance = anisotropy(normal)
    assert value < 0.1 and chance == pytest.approx(7.5 / np.sqrt(20_000), rel=0.02)
    # of a distribution (1 + n a n)/4 pi with a = diag(-c/2, -c/2, c): sqrt(3/2 a:a) = 1.5 c
    c = 0.6
    weight = 1.0 + np.einsum("ni,i,ni->n", normal, [-c / 2, -c / 2, c], normal)
    kept = normal[rng.uniform(0.0, 1.0 + c, len(normal)) < weight]
    assert anisotropy(kept)[0] == pytest.approx(1.5 * c, abs=0.1)


def test_cells_of_a_mixture_hold_equal_numbers():
    x = np.random.default_rng(2).uniform(size=(1003, 3))
    cell = cells_of(x, 25)
    number = np.bincount(cell)
    assert len(number) == 32 and number.max() - number.min() <= 1
    for n in range(2, 40):
        assert np.bincount(cells_of(x[:n], 1)).min() >= 1
    with pytest.raises(InputError, match="particles"):
        cells_of(x[:20], 25)


def test_lacey_is_0_of_separate_and_1_of_random_mixtures_within_its_error():
    rng = np.random.default_rng(3)
    x = rng.uniform(size=(4096, 3)) * [4.0, 1.0, 1.0]
    separate = (x[:, 0] > np.median(x[:, 0])).astype(np.int64)
    cell = cells_of(x, 32)
    apart = mixture(separate, cell)
    assert apart.lacey == pytest.approx(0.0, abs=1e-12)
    assert apart.chance == pytest.approx((1.0 - 32 / 4096) / (1.0 - 1 / 4096) / 32)
    for shares in ([0.5, 0.5], [0.1, 0.9], [0.2, 0.3, 0.5]):
        drawn = [mixture(rng.choice(len(shares), 4096, p=shares).astype(np.int64), cell) for _ in range(200)]
        index = np.array([one.lacey for one in drawn])
        assert index.mean() == pytest.approx(1.0, abs=4.0 * index.std() / np.sqrt(200))
        assert np.mean([one.error for one in drawn]) == pytest.approx(index.std(), rel=0.2)
    with pytest.raises(InputError, match="group"):
        mixture(np.zeros(4096, dtype=np.int64), cell)


def test_lacey_of_a_mixture_in_part_is_between():
    """Cells of which a share f is mixed and the rest separate: S² is (1 - f) S_0² + f S_R²."""
    rng, cells, n = np.random.default_rng(4), 1000, 20
    cell = np.repeat(np.arange(cells), n)
    group = np.where(np.arange(cells * n) // n % 2, 1, 0)
    mixed = np.flatnonzero(cell < 300)
    group[mixed] = rng.permutation(group[mixed])
    assert mixture(group, cell).lacey == pytest.approx(0.3, abs=0.01)


def test_mixing_time_of_an_exponential_approach():
    t = np.linspace(0.0, 10.0, 401)
    noise = np.random.default_rng(5).normal(0.0, 1e-4, len(t))
    assert mixing_time(t, 0.1 + 0.8 * (1.0 - np.exp(-t / 1.2)) + noise, 0.9) == pytest.approx(
        1.2 * np.log(10), rel=0.01
    )
    with pytest.raises(InputError, match="final"):
        mixing_time(t, np.full(len(t), 0.5), 0.5)


@pytest.mark.parametrize("cells", [4, 8, 32, 128])
def test_the_error_of_a_mixing_index_covers_random_mixtures(cells):
    """Twice the error holds 1 in at least 93 of 100 random mixtures (95 less what 400 of them scatter)."""
    rng, inside = np.random.default_rng(cells), 0
    cell = np.repeat(np.arange(cells), 25)
    for _ in range(400):
        found = mixture(rng.permutation(np.arange(len(cell)) % 2), cell)
        inside += abs(found.lacey - 1.0) <= 2.0 * found.error
    assert inside >= 0.93 * 400

"""What the box and the gas cells of a bed leave out: limits for `kncal.scene.limits`."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from kncal.core.checks import Array
from kncal.physics.fluidization import expanded_voidage
from kncal.scene.finding import Finding
from kncal.scene.gas import Gas
from kncal.scene.load import largest_superficial, settled_height
from kncal.scene.scene import Scene

#: Smallest gas cell edge over particle diameter: void fractions mean nothing below the first, are coarse below the
#: second.
CELL_SMALLEST, CELL_COARSE = 1.0, 2.5
#: Gas cell edge over particle diameter from which a cell averages over what it is to resolve, and share of the bed at
#: rest, or of its wider side, that it may be.
CELL_LARGE, CELL_SHARE = 8.0, 0.25
#: Fewer particles than this are no bed that gas cells would have to resolve.
FEWEST = 50


def places(scene: Scene, x: Array) -> Iterator[Finding]:
    """Find a packing that is not in the box, or not one."""
    if x.ndim != 2 or x.shape != (scene.number, 3) or not np.isfinite(x).all():
        yield Finding(
            "positions",
            "refuse",
            f"positions of shape {x.shape}: expected ({scene.number}, 3), finite",
        )
        return
    box = scene.box
    outside = ((x < 0.0) | (x > box.size)).any(axis=1)
    if outside.any():
        k = int(np.flatnonzero(outside)[0])
        yield Finding(
            "outside",
            "refuse",
            f"{np.count_nonzero(outside)} particle(s) outside the column, the first at {x[k].tolist()} m: expected "
            "centres inside",
        )


def depth(scene: Scene) -> Iterator[Finding]:
    """Find a depth in which particles meet their own images, or rub on both walls."""
    box, d = scene.box, scene.diameter
    if scene.front_back == "periodic" and scene.number and box.depth < 3.0 * d:
        yield Finding(
            "depth-periodic",
            "refuse",
            f"periodic depth of {box.depth / d:.3g} diameters: a particle would meet its own images: expected at "
            "least 3; deepen the column or use a layer",
        )
    if scene.front_back == "walls" and scene.number > 1 and box.depth < 1.5 * d:
        yield Finding(
            "depth-one-layer",
            "warn",
            f"walls {box.depth / d:.3g} diameters apart hold a single layer that rubs on both of them: expected "
            'layer = "y" for a two-dimensional bed, or a deeper box',
        )


def jet_faces(scene: Scene, gas: Gas) -> Iterator[Finding]:
    """Find a jet whose ends are not on faces of gas cells."""
    if (jet := gas.jet) is None:
        return
    h = scene.box.width / gas.cells[0]
    for name, x in (("x_low", jet.x_low), ("x_high", jet.x_high)):
        if abs(x / h - round(x / h)) > 1e-6:
            near = round(x / h) * h
            yield Finding(
                "jet-faces",
                "refuse",
                f"gas.jet.{name} = {x:g}: lies inside a gas cell: expected a cell face (multiples of {h:g} m; the "
                f"nearest is {near:g}), or another number of cells in x",
            )


def small_cells(scene: Scene, gas: Gas) -> Iterator[Finding]:
    """Find gas cells too small for the particles."""
    d = scene.diameter
    if not scene.number:
        return
    edges = {axis: size / n for axis, size, n in zip("xyz", scene.box.size, gas.cells, strict=True)}
    if scene.front_back == "layer":
        del edges["y"]  # the layer's only cell in depth is as deep as the case says
    axis = min(edges, key=edges.__getitem__)
    ratio = edges[axis] / d
    if ratio < CELL_SMALLEST * (1.0 - 1e-9):
        yield Finding(
            "cell-size",
            "refuse",
            f"gas cells are {ratio:.3g} particle diameters in {axis}, smaller than a particle: the void fraction has "
            f"no meaning there: expected at least {CELL_SMALLEST:g} (better {CELL_COARSE:g}); use fewer gas.cells",
        )
    elif ratio < CELL_COARSE * (1.0 - 1e-9) and gas.parcels_per_particle == 1:
        yield Finding(
            "cell-size",
            "warn",
            f"gas cells are {ratio:.3g} particle diameters in {axis}: a particle's whole volume goes to the cell of "
            f"its centre, which is coarse below {CELL_COARSE:g}; use fewer gas.cells or parcels_per_particle = 8",
        )


def coarse_cells(scene: Scene, gas: Gas, eps: float) -> Iterator[Finding]:
    """Find gas cells too large for the bed.

    Parameters
    ----------
    eps : void fraction of the packing [-]
    """
    box = scene.box
    if scene.number < FEWEST:
        return
    d, height = scene.diameter, settled_height(scene, eps)
    edges = {
        axis: size / n
        for axis, size, n in zip("xyz", box.size, gas.cells, strict=True)
        if axis != "y" or scene.front_back != "layer"  # a layer's only cell in depth is as deep as the case says
    }
    wide = "y" if "y" in edges and box.depth > box.width else "x"
    side = box.depth if wide == "y" else box.width
    fitting = math.floor(side / (CELL_COARSE * d) * (1.0 + 1e-9))
    if not scene.frozen and gas.cells["xyz".index(wide)] == 1 and fitting >= 2:
        yield Finding(
            "cell-single",
            "refuse",
            f"one gas cell over the whole {'depth' if wide == 'y' else 'width'} of {side / d:.3g} particle diameters: "
            "a bed that moves has gas that rises here and particles that sink there, which one cell cannot hold: "
            f"expected gas.cells of at most {CELL_LARGE:g} diameters, {fitting} in {wide}",
        )
        return
    large = {axis: f"{edge / d:.3g} particle diameters" for axis, edge in edges.items() if edge > CELL_LARGE * d}
    if edges["z"] > CELL_SHARE * height:
        large.setdefault("z", f"{edges['z'] / height:.2g} of the height of the bed at rest ({height:.3g} m)")
    if not scene.frozen and edges[wide] > CELL_SHARE * side * (1.0 + 1e-9):
        large.setdefault(wide, f"{edges[wide] / side:.2g} of the bed's {'depth' if wide == 'y' else 'width'}")
    for axis, size in large.items():
        yield Finding(
            "cell-coarse",
            "warn",
            f"gas cells are {size} in {axis}: they average over what drives the bed (bubbles, its surface): expected "
            f"at most {CELL_LARGE:g} diameters and {CELL_SHARE:g} of the bed; use more gas.cells, or a larger bed",
        )


def room(scene: Scene, gas: Gas, eps: float) -> Iterator[Finding]:
    """Find a column too low for the bed and its expansion."""
    height = scene.box.height
    if scene.number == 1:
        return
    rest = settled_height(scene, eps)
    if rest > height:
        yield Finding(
            "column-low",
            "refuse",
            f"the settled bed is about {rest:.3g} m high (eps_g = {eps:.2g}), the column {height:.3g} m: expected room "
            "for the bed and its expansion",
        )
        return
    speed = largest_superficial(scene)
    if speed == 0.0:
        return
    hovering = expanded_voidage(speed, scene.diameter, scene.density, gas.density, gas.viscosity, scene.g)
    expanded = rest * (1.0 - eps) / (1.0 - hovering) if hovering < 1.0 else math.inf
    expanded = max(expanded, rest)
    # Bubbling beds throw particles to about twice their mean height; the lid must be above that.
    if 2.0 * expanded > height:
        yield Finding(
            "column-low",
            "warn",
            f"the bed expands to about {expanded:.3g} m on average (homogeneous, {rest:.3g} m at rest) and throws "
            f"particles to about twice that, the column is {height:.3g} m: particles may hit the lid; expected a "
            "higher box",
        )

"""A LIGGGHTS deck written by hand for tests: one sphere and a wall, linear contact, one dump, an end marker."""

from __future__ import annotations

RADIUS = 1e-3
DENSITY = 2500.0
K_N = 1000.0
GAMMA_N = 900.0  # 1/s, per effective mass
DT = 1e-6
COLUMNS = "id type x y z vx vy vz omegax omegay omegaz fx fy fz"


def wall_deck(
    *,
    steps: int = 600,
    velocity: float = -0.5,
    height: float = 1.01e-3,
    thermo: int = 200,
    every: str = "50",
    spheres: int = 1,
    marker: bool = True,
    extra: str = "",
) -> str:
    """The deck; ``every`` is the interval of the dump or ``v_name``; all spheres start at the same point."""
    return f"""\
units         si
atom_style    granular
atom_modify   map array
boundary      f f f
newton        off
communicate   single vel yes
region        dom block -0.004 0.004 -0.004 0.004 -0.004 0.004 units box
create_box    1 dom
neighbor      0.0005 bin
neigh_modify  delay 0
fix p1 all property/global kn peratomtypepair 1 {K_N!r}
fix p2 all property/global kt peratomtypepair 1 0.0
fix p3 all property/global gamman peratomtypepair 1 {GAMMA_N!r}
fix p4 all property/global gammat peratomtypepair 1 0.0
fix p5 all property/global coefficientFriction peratomtypepair 1 0.0
pair_style    gran model hooke/stiffness tangential history
pair_coeff    * *
timestep      {DT!r}
fix           w all wall/gran model hooke/stiffness tangential history primitive type 1 zplane 0.0
{f"create_atoms 1 single 0 0 {height!r} units box{chr(10)}" * spheres}
set           group all diameter {2 * RADIUS!r} density {DENSITY!r}
set           atom 1 vz {velocity!r}
fix           mv all nve/sphere
{extra}
dump          d all custom {every if every.isdigit() else 1} particles.dump {COLUMNS}
dump_modify   d sort id format "%d %d {" ".join(["%.17g"] * 12)}"
{"" if every.isdigit() else f"dump_modify d every {every}"}
thermo_style  custom step atoms ke
thermo_modify norm no lost error
thermo        {thermo}
run           {steps}
{'print "KNCAL_DONE"' if marker else ""}
"""

"""Kuwabara–Kono: Hertz with the dashpot of a viscoelastic sphere, C x^(1/2) x_dot."""

from kncal.physics.laws.polar import HertzDashpot

KUWABARA_KONO = HertzDashpot(
    name="kuwabara_kono",
    title="Kuwabara–Kono (viscoelastic Hertz)",
    source="Kuwabara & Kono, Jpn. J. Appl. Phys. 26 (1987) 1230; Brilliantov et al., Phys. Rev. E 53 (1996) 5382",
    note=(
        "Derived from bulk viscosity, so the law to take for viscoelastic spheres. e_n belongs to one impact "
        "speed: 1 - e_n grows as v_0^(1/5) for nearly elastic impacts."
    ),
    damping_exponent=0.5,
    e_depends_on_speed=True,
    liggghts="hertz/stiffness",
)

"""Gas through particles: pressure gradient, drag, minimum fluidisation, terminal velocity, relaxation time.

SI units; every argument may be a float or an array, arrays broadcast against each other. Equal spheres of
``diameter`` d [m] in a gas of ``density_gas`` rho_g [kg/m³] and (dynamic) ``viscosity`` mu [Pa s]; ``eps_g`` is the
gas volume fraction [-], ``U_0`` the superficial and ``slip`` the interstitial gas velocity relative to the particles
[m/s]. Two-fluid texts differ in where they put the pressure gradient; here *model B* is what `particle_drag` gives
(the whole pressure gradient in the gas, the drag divided by eps_g), as in OpenFOAM's DPMFoam.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import Array, in_range, positive
from kncal.physics.material import FloatOrArray, plain

#: Void fraction above which the Gidaspow drag changes from Ergun to Wen & Yu.
EPS_DILUTE = 0.8
#: Reynolds number from which the drag coefficient of a sphere is taken as constant (Newton's regime), and its value.
RE_NEWTON, CD_NEWTON = 1000.0, 0.44


def reynolds(velocity: ArrayLike, diameter: ArrayLike, density_gas: ArrayLike, viscosity: ArrayLike) -> FloatOrArray:
    r"""Return the Reynolds number of a sphere, :math:`Re = \rho_g |u| d/\mu` [-].

    Examples
    --------
    >>> round(reynolds(0.457402, 1e-4, 1.2, 1.8e-5), 4)
    3.0493
    """
    d, rho, mu = _gas(diameter, density_gas, viscosity)
    return plain(np.asarray(rho * np.abs(np.asarray(velocity, dtype=np.float64)) * d / mu))


def archimedes(
    diameter: ArrayLike, density: ArrayLike, density_gas: ArrayLike, viscosity: ArrayLike, gravity: ArrayLike = 9.81
) -> FloatOrArray:
    r"""Return the Archimedes number, :math:`Ar = \rho_g (\rho_p - \rho_g) g d^3/\mu^2` [-].

    Parameters
    ----------
    density : of the particles [kg/m³], above that of the gas
    gravity : [m/s²]

    Raises
    ------
    InputError
        If a value is not positive, or the particles are lighter than the gas.
    """
    d, rho, mu = _gas(diameter, density_gas, viscosity)
    return plain(np.asarray(rho * _excess(density, rho) * positive("gravity", gravity, unit="m/s²") * d**3 / mu**2))


def drag_coefficient(Re: ArrayLike) -> FloatOrArray:
    r"""Return the drag coefficient of one sphere in unbounded gas [-], after Schiller and Naumann [1]_.

    .. math:: C_d = \frac{24}{Re} (1 + 0.15 Re^{0.687}) \quad (Re < 1000), \qquad 0.44 \text{ above}

    Notes
    -----
    Re is that of the slip, > 0. Within 5 % of the standard drag curve up to Re = 800 [2]_; the step at 1000 is
    0.4 %, and the constant holds to about 2e5.

    References
    ----------
    .. [1] Schiller, Naumann, Z. Ver. Dtsch. Ing. 77 (1933) 318-320.
    .. [2] Clift, Grace, Weber, Bubbles, Drops, and Particles (1978), section 5.2.
    """
    number = positive("Re", Re)
    return plain(np.asarray(_drag_times_reynolds(number) / number))


def ergun_gradient(
    U_0: ArrayLike, eps_g: ArrayLike, diameter: ArrayLike, density_gas: ArrayLike, viscosity: ArrayLike
) -> FloatOrArray:
    r"""Return the pressure gradient of a flow through a packed bed [Pa/m], positive against the flow, after Ergun [1]_.

    .. math:: \frac{\Delta p}{H} = 150 \frac{\mu (1-\varepsilon)^2 U_0}{\varepsilon^3 d^2}
              + 1.75 \frac{\rho_g (1-\varepsilon) U_0^2}{\varepsilon^3 d}

    Parameters
    ----------
    U_0 : superficial velocity [m/s], >= 0
    eps_g : void fraction [-], above 0 and at most 1

    Notes
    -----
    Fitted to 640 experiments with 1 < Re/(1 - eps_g) < 2400 and eps_g of about 0.36 to 0.5. Near a wall the bed is
    looser; below about ten diameters of width the gradient is lower than this.

    Examples
    --------
    >>> round(ergun_gradient(0.3, 0.4, 1.2e-3, 1.2, 1.8e-5), 3)
    4640.625

    References
    ----------
    .. [1] Ergun, Chem. Eng. Prog. 48 (1952) 89-94.
    """
    velocity = in_range("U_0", U_0, 0.0, np.inf, unit="m/s")
    d, rho, mu = _gas(diameter, density_gas, viscosity)
    eps = _voidage(eps_g)
    solids = 1.0 - eps
    viscous = 150.0 * mu * solids**2 * velocity / (eps**3 * d**2)
    return plain(np.asarray(viscous + 1.75 * rho * solids * velocity**2 / (eps**3 * d)))


def particle_drag(
    eps_g: ArrayLike, slip: ArrayLike, diameter: ArrayLike, density_gas: ArrayLike, viscosity: ArrayLike
) -> FloatOrArray:
    r"""Return the drag force on a particle per its volume and per slip velocity [kg/(m³ s)], Gidaspow [1]_, model B.

    The force of the gas on a particle of volume V is ``V * particle_drag(...) * (u_gas - u_particle)``, plus the
    weight of the displaced gas. With Re = rho_g slip d/mu:

    .. math:: \frac{\mu}{\varepsilon d^2} \left(150 \frac{1-\varepsilon}{\varepsilon} + 1.75 Re\right)
              \ (\varepsilon < 0.8), \qquad
              \frac{3}{4} \frac{\mu}{\varepsilon d^2} (C_d Re)(\varepsilon Re)\, \varepsilon^{-2.65} \text{ else}

    Notes
    -----
    Ergun's equation in a dense bed and Wen & Yu's [2]_ in a dilute one; it jumps at 0.8, in a bed of 1 mm particles
    in air by up to some 30 %. C_d as in `drag_coefficient`. At eps_g = 1 it is the drag on a single sphere.

    References
    ----------
    .. [1] Gidaspow, Multiphase Flow and Fluidization (1994), section 2.4.
    .. [2] Wen, Yu, Chem. Eng. Prog. Symp. Ser. 62 (1966) 100-111.
    """
    eps, speed = _voidage(eps_g), in_range("slip", slip, 0.0, np.inf, unit="m/s")
    return plain(drag_per_slip(eps, speed, *_gas(diameter, density_gas, viscosity)))


def drag_per_slip(
    eps_g: Array, slip: Array, diameter: Array, density_gas: float | Array, viscosity: float | Array
) -> Array:
    """`particle_drag` of arrays that are known to be in range: for the inside of a loop, where checks cost the most."""
    Re = density_gas * slip * diameter / viscosity
    dense = 150.0 * (1.0 - eps_g) / eps_g + 1.75 * Re
    dilute = 0.75 * _drag_times_reynolds(eps_g * Re) * eps_g**-2.65
    return np.asarray(np.where(eps_g < EPS_DILUTE, dense, dilute) * viscosity / (eps_g * diameter**2))


def relaxation_time(
    density: ArrayLike,
    diameter: ArrayLike,
    density_gas: ArrayLike,
    viscosity: ArrayLike,
    *,
    slip: ArrayLike = 0.0,
    eps_g: ArrayLike = 1.0,
) -> FloatOrArray:
    r"""Return the particle relaxation time [s]: mass over drag per slip, :math:`\rho_p/` `particle_drag`.

    Without slip and at eps_g = 1 it is Stokes' :math:`\rho_p d^2/(18 \mu)`.

    Examples
    --------
    >>> round(relaxation_time(2000.0, 1e-4, 1.2, 1.8e-5), 5)
    0.06173
    """
    drag = particle_drag(eps_g, slip, diameter, density_gas, viscosity)
    return plain(np.asarray(positive("density", density, unit="kg/m³") / drag))


def minimum_fluidization_velocity(
    diameter: ArrayLike,
    density: ArrayLike,
    density_gas: ArrayLike,
    viscosity: ArrayLike,
    eps_mf: ArrayLike,
    gravity: ArrayLike = 9.81,
) -> FloatOrArray:
    r"""Return the superficial velocity U_mf [m/s] at which Ergun's gradient carries a bed of voidage ``eps_mf``.

    The positive root of

    .. math:: 150 \frac{\mu (1-\varepsilon)}{\varepsilon^3 d^2} U + 1.75 \frac{\rho_g}{\varepsilon^3 d} U^2
              = (\rho_p - \rho_g) g

    Notes
    -----
    It changes by about 4 % per 0.01 of ``eps_mf``: give the measured voidage of the settled bed. Sources as in
    `ergun_gradient`.

    Examples
    --------
    >>> round(minimum_fluidization_velocity(4e-3, 2700.0, 1.205, 1.8e-5, 0.42), 2)
    1.84
    """
    d, rho, mu = _gas(diameter, density_gas, viscosity)
    eps = in_range("eps_mf", eps_mf, 0.0, 0.99, low_open=True)
    weight = _excess(density, rho) * positive("gravity", gravity, unit="m/s²")
    linear = 150.0 * mu * (1.0 - eps) / (eps**3 * d**2)
    square = 1.75 * rho / (eps**3 * d)
    # the form of the root that does not cancel for small particles
    return plain(np.asarray(2.0 * weight / (linear + np.sqrt(linear**2 + 4.0 * square * weight))))


def minimum_fluidization_velocity_wen_yu(
    diameter: ArrayLike,
    density: ArrayLike,
    density_gas: ArrayLike,
    viscosity: ArrayLike,
    gravity: ArrayLike = 9.81,
) -> FloatOrArray:
    r"""Return U_mf [m/s] from the correlation of Wen and Yu [1]_, which needs no voidage.

    .. math:: Re_{mf} = \sqrt{33.7^2 + 0.0408 Ar} - 33.7

    Notes
    -----
    From 284 data of 0.001 < Re_mf < 4000; standard deviation 34 %.

    References
    ----------
    .. [1] Wen, Yu, AIChE J. 12 (1966) 610-612.
    """
    d, rho, mu = _gas(diameter, density_gas, viscosity)
    number = 0.0408 * np.asarray(archimedes(d, density, rho, mu, gravity))
    return plain(np.asarray(number / (np.sqrt(33.7**2 + number) + 33.7) * mu / (rho * d)))


def terminal_velocity(
    diameter: ArrayLike,
    density: ArrayLike,
    density_gas: ArrayLike,
    viscosity: ArrayLike,
    gravity: ArrayLike = 9.81,
) -> FloatOrArray:
    r"""Return the speed at which a single sphere falls in still gas [m/s], with the drag of `drag_coefficient`.

    Weight less buoyancy equals drag: :math:`\frac{3}{4} C_d Re^2 = Ar`, solved to rounding.

    Examples
    --------
    >>> round(terminal_velocity(1e-4, 2000.0, 1.2, 1.8e-5, 9.80665), 6)
    0.457402
    """
    d, rho, mu = _gas(diameter, density_gas, viscosity)
    Ar = np.asarray(archimedes(d, density, rho, mu, gravity))
    Re = _terminal_reynolds(Ar)
    return plain(np.asarray(Re * mu / (rho * d)))


def settling_velocity(
    times: ArrayLike,
    diameter: float,
    density: float,
    density_gas: float,
    viscosity: float,
    *,
    gravity: float = 9.81,
    U_gas: float = 0.0,
) -> Array:
    r"""Return the upward velocity [m/s] of one sphere released at rest in gas that rises with ``U_gas`` [m/s].

    .. math:: \dot v = -g (1 - \rho_g/\rho_p) + \frac{18 \mu}{\rho_p d^2} (1 + 0.15 Re^{0.687}) (U - v)

    and :math:`C_d = 0.44` above Re = 1000; one-way (the gas does not feel the sphere), no added mass. Integrated to
    1e-11 relative. Returns an array of the shape of ``times`` [s], which must be >= 0.

    Examples
    --------
    >>> settling_velocity([0.01, 0.1, 0.35], 1e-4, 2000.0, 1.2, 1.8e-5, gravity=9.80665, U_gas=0.4).round(6)
    array([-0.012553, -0.052631, -0.057393])
    """
    from scipy.integrate import solve_ivp

    at = in_range("times", times, 0.0, np.inf, unit="s")
    fall = float(_excess(density, np.asarray(density_gas))) / density * float(positive("gravity", gravity))

    def rate(_: float, v: Array) -> Array:
        slip = U_gas - v
        return slip / relaxation_time(density, diameter, density_gas, viscosity, slip=np.abs(slip)) - fall

    order, back = np.unique(at, return_inverse=True)
    if order.size == 0 or order[-1] == 0.0:
        return np.zeros(at.shape)
    solution = solve_ivp(rate, (0.0, order[-1]), [0.0], method="DOP853", t_eval=order, rtol=1e-11, atol=1e-14)
    return np.asarray(solution.y[0][back].reshape(at.shape))


def expanded_voidage(
    U_0: float, diameter: float, density: float, density_gas: float, viscosity: float, gravity: float = 9.81
) -> float:
    """Return the void fraction at which a homogeneous suspension hovers at the superficial velocity ``U_0`` [-].

    `particle_drag` at the slip ``U_0/eps_g`` carries the weight less buoyancy. 0.2 means: not lifted at any
    packing; 1: above the terminal velocity, carried away. A bubbling bed expands less than this on average.
    """
    from scipy.optimize import brentq

    if float(positive("U_0", U_0, unit="m/s")) >= float(
        terminal_velocity(diameter, density, density_gas, viscosity, gravity)
    ):
        return 1.0
    weight = float(_excess(density, np.asarray(density_gas))) * gravity

    def surplus(eps: float) -> float:
        return float(particle_drag(eps, U_0 / eps, diameter, density_gas, viscosity)) * U_0 / eps - weight

    low = 0.2
    return low if surplus(low) <= 0.0 else float(brentq(surplus, low, 1.0, xtol=1e-12))


def _drag_times_reynolds(Re: Array) -> Array:
    """C_d Re of a sphere; 24 at Re = 0."""
    return np.where(Re < RE_NEWTON, 24.0 * (1.0 + 0.15 * Re**0.687), CD_NEWTON * Re)


def _terminal_reynolds(Ar: Array) -> Array:
    """Root of 18 Re + 2.7 Re^1.687 = Ar, or of 0.33 Re² = Ar above Re = 1000; 1000 where the curve steps over Ar."""
    Re = np.minimum(Ar / 18.0, (Ar / 2.7) ** (1.0 / 1.687))  # both are above the root: Newton on a convex curve
    for _ in range(60):
        step = (18.0 * Re + 2.7 * Re**1.687 - Ar) / (18.0 + 2.7 * 1.687 * Re**0.687)
        Re = Re - step
        if np.all(np.abs(step) <= 1e-15 * Re):
            break
    newton = np.sqrt(Ar / (0.75 * CD_NEWTON))
    return np.where(Re < RE_NEWTON, Re, np.maximum(newton, RE_NEWTON))


def _gas(diameter: ArrayLike, density_gas: ArrayLike, viscosity: ArrayLike) -> tuple[Array, Array, Array]:
    return (
        positive("diameter", diameter, unit="m"),
        positive("density_gas", density_gas, unit="kg/m³"),
        positive("viscosity", viscosity, unit="Pa s"),
    )


def _voidage(eps_g: ArrayLike) -> Array:
    return in_range("eps_g", eps_g, 0.0, 1.0, low_open=True)


def _excess(density: ArrayLike, density_gas: Array) -> Array:
    difference: Array = positive("density", density, unit="kg/m³") - density_gas
    positive("density - density_gas", difference, unit="kg/m³", hint="the particles must be heavier than the gas")
    return difference

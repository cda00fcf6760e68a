"""Named problems: a system, a start, lengths of runs, and a reference value, each with its source.

``zoo.lorenz63(rho=30)`` is a `Problem`; ``zoo.names()`` lists them all; ``problem.spectrum()`` computes.
``zoo.collision_statistics(problem)`` measures the rate of collisions and the pressure of hard disks and spheres.
Parameters that are numbers are part of `args`: changing them compiles nothing.
"""

from .bodies.billiards import ellipse, lorentz_gas, mean_free_path, sinai_billiard, stadium, wedge
from .bodies.disks_and_spheres import hard_disks, hard_spheres
from .bodies.statistics import CollisionStatistics, collision_statistics
from .flows.constrained import diode_circuit, lorenz_dae, pendulum_dae, rotated_dae, spring_damper_dae, swing_dae
from .flows.smooth import lorenz63, lorenz96, rossler
from .hamiltonian.celestial import double_pendulum, kepler, restricted_three_body
from .hamiltonian.lattices import klein_gordon, schroedinger_lattice
from .hamiltonian.oscillators import fpu_alpha, fpu_beta, hamiltonian_3d, henon_heiles
from .mappings.coupled_maps import coupled_standard_maps, froeschle_map
from .mappings.maps import baker_map, cat_map, henon_map, kaplan_yorke_map, logistic_map, standard_map
from .mappings.restitution import cardiac_alternans
from .mechanics.brakes import abs_brake
from .mechanics.friction import block_on_plate, friction_pendulum, relay_feedback, stick_slip_belt
from .mechanics.hoppers import slip_runner, vertical_hopper
from .mechanics.impacts import bouncing_ball, impact_oscillator, kicked_ball, zaslavsky
from .mechanics.kicked import escapement_clock, kicked_rotor, moving_wall_billiard, paddle_juggler
from .mechanics.rattling import gear_rattle, rocking_block
from .mechanics.walkers import rimless_wheel, simplest_walker
from .problem import Problem, Reference, get, unknown
from .published.table import flow, flow_names
from .switched.circuits import boost_converter, buck_converter, chua, corron_oscillator
from .switched.gene_networks import glass_network
from .switched.neurons import adex, integrate_and_fire
from .switched.phase_locked import charge_pump_pll
from .switched.piecewise import beta_clock, conewise_linear, grow_reset, skew_tent_roof
from .switched.sparse_networks import sparse_network
from .switched.spiking import conductance_neuron, izhikevich, two_compartment_neuron

__all__ = [
    "Problem",
    "Reference",
    "get",
    "flow",
    "flow_names",
    "mean_free_path",
    "names",
    # statistics of the collisions of hard bodies
    "CollisionStatistics",
    "collision_statistics",
    # maps
    "henon_map",
    "logistic_map",
    "cat_map",
    "standard_map",
    "baker_map",
    "kaplan_yorke_map",
    "cardiac_alternans",
    "froeschle_map",
    "coupled_standard_maps",
    # smooth flows
    "lorenz63",
    "rossler",
    "lorenz96",
    # Hamiltonian systems
    "henon_heiles",
    "hamiltonian_3d",
    "fpu_beta",
    "fpu_alpha",
    "klein_gordon",
    "schroedinger_lattice",
    "double_pendulum",
    "kepler",
    "restricted_three_body",
    # flows with jumps
    "bouncing_ball",
    "kicked_ball",
    "zaslavsky",
    "impact_oscillator",
    "integrate_and_fire",
    "sparse_network",
    "adex",
    "izhikevich",
    "conductance_neuron",
    "two_compartment_neuron",
    "glass_network",
    "kicked_rotor",
    "escapement_clock",
    "paddle_juggler",
    "moving_wall_billiard",
    "conewise_linear",
    "beta_clock",
    "skew_tent_roof",
    "grow_reset",
    # dry friction and relays
    "friction_pendulum",
    "block_on_plate",
    "stick_slip_belt",
    "relay_feedback",
    "abs_brake",
    # circuits
    "chua",
    "buck_converter",
    "boost_converter",
    "corron_oscillator",
    "charge_pump_pll",
    # differential–algebraic systems
    "spring_damper_dae",
    "rotated_dae",
    "lorenz_dae",
    "pendulum_dae",
    "diode_circuit",
    "swing_dae",
    # impacts on both sides
    "rocking_block",
    "gear_rattle",
    # walkers, runners
    "rimless_wheel",
    "simplest_walker",
    "vertical_hopper",
    "slip_runner",
    # event-driven: the next event is known exactly
    "hard_disks",
    "hard_spheres",
    # billiards
    "sinai_billiard",
    "lorentz_gas",
    "stadium",
    "ellipse",
    "wedge",
]


def names() -> list[str]:
    """The names of the zoo's problems, maps first.

    Example:
        >>> from lyaphybrid import zoo
        >>> "hard_disks" in zoo.names()
        True
    """
    return __all__[__all__.index("henon_map") :]


def __getattr__(name: str):
    raise AttributeError(unknown(name))

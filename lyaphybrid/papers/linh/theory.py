"""Numerical tests of the theory of Linh, Truong & Tuyen: Λ, Theorem 4.1 with M δ, stability of exponents."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from ...analysis.spectra import lyapunov_spectrum
from ...analysis.trajectories import tangent_map, trajectory
from ...integrators import HalfExplicit
from ...systems.consistency import tangent_frame
from ...systems.daes.semi_linear import DAE
from .tables import TOLERANCES, problem_of

__all__ = [
    "LENGTHS", "SIZES", "Characteristic", "Perturbed", "Turning", "characteristic", "pencil", "perturbed", "turning",
]  # fmt: skip

RTOL_OF_PIECES = 1e-12
LENGTHS = (10, 20, 50, 100)  # T of Λ(T), in pieces of length 1
SIZES = (1e-1, 1e-2, 1e-3, 1e-4)  # δ of the perturbations of E and A
LINEAR_LENGTH = 200.0  # length of runs of linear equations; the first half is not counted
AT = 20  # times at which the linearisations are compared, one unit apart


@dataclasses.dataclass(frozen=True)
class Characteristic:
    """Λ(T) = (YᵀY)^(1/2T) of Example 5.1 (7), with the columns of Ē⁻¹ as Y(0), for each of `LENGTHS`.

    Attributes:
        exponents: (lengths, 2) ln μ_i.
        vectors: (lengths, 2, 2) the eigenvectors p_i as columns, their largest component positive.
    """

    exponents: np.ndarray
    vectors: np.ndarray


def characteristic(lengths=LENGTHS) -> Characteristic:
    """Λ without forming YᵀY, whose condition number e^(5.3 T) overflows.

    Y = Q D U, D = diag(e^(s_i)), U unit upper triangular; U converges, because the increments
    R_ij e^(s_j − s_i) of its entries decay. The QR factors P T of Uᵀ then give Yᵀ = P (T D) Qᵀ, and T D is diagonal up
    to e^(s₂ − s₁).
    """
    system, x, args = problem_of("5.1")
    columns, factor = np.linalg.qr(np.asarray(tangent_frame(system, jnp.zeros(()), x, args)))
    total, unit, found = np.zeros(2), np.eye(2), []
    for piece in range(max(lengths) + 1):
        signs, sizes = np.sign(np.diag(factor)), np.abs(np.diag(factor))
        columns, factor = columns * signs, factor * signs[:, None]
        share = factor / sizes[:, None] * np.exp(np.minimum(total - total[:, None], 0.0))
        unit, total = np.triu(share) @ unit, total + np.log(sizes)
        if piece in lengths:
            found.append(_eigen(unit, total, piece))
        moved = tangent_map(
            system, x, args, t0=float(piece), t1=1.0, method=HalfExplicit(rtol=RTOL_OF_PIECES, atol=RTOL_OF_PIECES)
        )
        x = moved.x
        columns, factor = np.linalg.qr(np.asarray(moved.matrix) @ columns)
    return Characteristic(*(np.stack(values) for values in zip(*found, strict=True)))


def _eigen(unit, total, length):
    vectors, upper = np.linalg.qr(unit.T)
    exponents = (total + np.log(np.abs(np.diag(upper)))) / length
    vectors = vectors * np.sign(vectors[np.argmax(np.abs(vectors), axis=0), [0, 1]])
    return exponents, vectors


@dataclasses.dataclass(frozen=True)
class Turning:
    """Theorem 4.1 on Example 5.2, γ = (1, 2, 3), by `TOLERANCES`: ω(t) = t + δ t/20 with δ = TOL, 0 ≤ t ≤ 20.

    Attributes:
        difference: |f_x(ω, ψ(ω)) − f_x(t, φ(t))| (tolerances, times).
        in_time: M |ω − t|, and in_state: N |ψ(ω) − φ(t)|, of the same shape.
    """

    difference: np.ndarray
    in_time: np.ndarray
    in_state: np.ndarray

    @property
    def share(self) -> np.ndarray:
        """Largest ratio of the differences to the bound, by tolerance."""
        return np.max(self.difference / (self.in_time + self.in_state), axis=1)

    @property
    def without_time(self) -> np.ndarray:
        """The same ratio with the bound N ε alone."""
        return np.max(self.difference / self.in_state, axis=1)


def turning() -> Turning:
    """Compare the linearisations at each time."""
    system, x0, args = problem_of("5.2")

    def path(tolerance, stretch):
        return np.asarray(
            trajectory(system, x0, args, t1=AT * stretch, n=AT, method=HalfExplicit(rtol=tolerance, atol=tolerance)).x
        )

    def first(t, x):
        return jax.jacfwd(lambda x: system.field.residual(t, x, args))(x)

    def size(tensors):
        return np.sqrt(np.sum(np.asarray(tensors).reshape(len(tensors), -1) ** 2, axis=1))

    slopes = jax.jit(jax.vmap(first))
    mixed, curved = jax.jit(jax.vmap(jax.jacfwd(first))), jax.jit(jax.vmap(jax.jacfwd(first, argnums=1)))
    true, times = path(1e-13, 1.0), np.linspace(0.0, AT, AT)
    # f_x is quadratic in x and trigonometric in t: it is sampled over the box of all points and a turn, times 1.5.
    many = np.repeat(np.linspace(0, 2 * np.pi, 48, endpoint=False), len(true)), np.tile(true, (48, 1))
    bounds = [1.5 * np.max(size(tensors(*many))) for tensors in (mixed, curved)]
    found = []
    for tolerance in TOLERANCES:
        stretch = 1 + tolerance / AT
        near = path(tolerance, stretch)
        apart = size(slopes(times * stretch, near) - slopes(times, true))[1:]
        found.append((apart, bounds[0] * times[1:] * (stretch - 1), bounds[1] * size(near - true)[1:]))
    return Turning(*(np.stack(values) for values in zip(*found, strict=True)))


@dataclasses.dataclass(frozen=True)
class Perturbed:
    """Definition 2.3 on Example 5.1 at rest, [E + ΔE] x' = [A + ΔA] x, by `SIZES`.

    Attributes:
        constant: (sizes, 2) exponents where ΔE and ΔA are constant; eigenvalues: (sizes, 2) of the pencil, by LAPACK.
        periodic: (sizes, 2) where they are δ cos t and δ sin √2t times the same matrices.
    """

    constant: np.ndarray
    eigenvalues: np.ndarray
    periodic: np.ndarray


def _matrices():
    """E, A, and directions of ΔE (no change of the zero rows) and ΔA, of norm one."""
    system, x0, args = problem_of("5.1")
    leading = np.asarray(system.field.leading(jnp.zeros(()), args))
    slope = np.asarray(jax.jacfwd(lambda x: system.field.residual(jnp.zeros(()), x, args))(jnp.zeros_like(x0)))
    rows = np.arange(16.0).reshape(4, 4)
    in_leading, in_slope = np.cos(rows), np.sin(2 * rows + 1)
    in_leading[2:] = 0.0
    return leading, slope, in_leading / np.linalg.norm(in_leading, 2), in_slope / np.linalg.norm(in_slope, 2)


def pencil(size: float) -> np.ndarray:
    """The finite eigenvalues (2,) of λ (E + ΔE) − (A + ΔA), descending."""
    leading, slope, in_leading, in_slope = _matrices()
    values = scipy.linalg.eigvals(slope + size * in_slope, leading + size * in_leading)
    finite = np.sort_complex(values[np.argsort(np.abs(values))[:2]])
    return np.real(finite)[::-1]


def perturbed() -> Perturbed:
    """Exponents of the perturbed equations, by `lyapunov_spectrum` as all others."""
    leading, slope, in_leading, in_slope = (jnp.asarray(matrix) for matrix in _matrices())

    def swing(t, args):
        return jnp.where(args["moving"], jnp.cos(t), 1.0), jnp.where(args["moving"], jnp.sin(jnp.sqrt(2.0) * t), 1.0)

    system = DAE(
        lambda t, args: leading + args["size"] * swing(t, args)[0] * in_leading,
        lambda t, x, args: (slope + args["size"] * swing(t, args)[1] * in_slope) @ x,
        n_differential=2,
    )

    def exponents(size, moving):
        args = {"size": jnp.asarray(size), "moving": jnp.asarray(moving)}
        method = HalfExplicit(rtol=1e-10, atol=1e-10)
        found = lyapunov_spectrum(
            system, jnp.zeros(4), args, t1=LINEAR_LENGTH / 2, transient=LINEAR_LENGTH / 2, method=method, blocks=2
        )
        return np.asarray(found.exponents)

    constant, periodic = (np.stack([exponents(size, moving) for size in SIZES]) for moving in (False, True))
    return Perturbed(constant, np.stack([pencil(size) for size in SIZES]), periodic)

"""A structure-preserving power grid (Bergen & Hill, IEEE Trans. PAS-100 (1981) 25): buses and some generators.

δ' = ω, M ω' = P − D ω − Y sin(δ − θ) at each generator; at each bus, an algebraic equation for its phase θ,

    0 = Y sin(δ − θ), where there is a generator, − load + Σ over lines of B sin(θ_j − θ).

Its Jacobian in θ is banded: buses are numbered across the strip. The reference exponents use hand-written
Jacobians as SciPy's sparse matrices.
"""

import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg

from ....systems.daes.semi_linear import DAE

__all__ = ["Grid"]

COUPLING, LINE, LOAD = 2.0, 1.5, 0.02


class Grid:
    """`length` rows of `width` buses, a generator at every `every`-th."""

    def __init__(self, length: int, width: int = 3, every: int = 9):
        self.width, self.buses = width, length * width
        along = [(i, i + width) for i in range(self.buses - width)]
        across = [(i, i + 1) for i in range(self.buses - 1) if (i + 1) % width]
        self.lines = np.array(along + across)
        self.at = np.arange(0, self.buses, every)
        count = len(self.at)
        golden = (np.arange(1, count + 1) * (np.sqrt(5) - 1) / 2) % 1
        self.inertia, self.damping = 0.5 + golden, 0.2 + 0.4 * golden[::-1]
        self.power = np.full(count, LOAD * self.buses / count)
        self.d, self.n = 2 * count, 2 * count + self.buses
        angles = scipy.optimize.root(self._still, np.zeros(count + self.buses - 1), jac=self._still_jacobian)
        assert angles.success
        delta, theta = np.concatenate([[0.0], angles.x])[:count], angles.x[count - 1 :]
        self.rest = np.concatenate([delta, np.zeros(count), theta])

    def residual(self, t, x, args):
        """F (n,), of x = (δ, ω, θ)."""
        count = len(self.at)
        delta, omega, theta = x[:count], x[count : 2 * count], x[2 * count :]
        given = COUPLING * jnp.sin(delta - theta[self.at])
        first, second = self.lines.T
        flow = LINE * jnp.sin(theta[second] - theta[first])
        net = jnp.full(self.buses, -LOAD).at[self.at].add(given).at[first].add(flow).at[second].add(-flow)
        turning = (self.power - given - self.damping * omega) / self.inertia
        return jnp.concatenate([omega, turning, net])

    def dae(self, bandwidth: int | None) -> DAE:
        """The grid as an `lh.DAE`, with full or banded constraints."""
        leading = np.diag((np.arange(self.n) < self.d).astype(float))
        return DAE(lambda t, args: jnp.asarray(leading), self.residual, self.d, bandwidth=bandwidth)

    def jacobians(self, x):
        """Sparse ∂f₁/∂w, ∂f₁/∂θ, ∂f₂/∂w, ∂f₂/∂θ with w = (δ, ω)."""
        count, first, second = len(self.at), *self.lines.T
        delta, theta = x[:count], x[2 * count :]
        pull = scipy.sparse.diags(COUPLING * np.cos(delta - theta[self.at]))
        here = scipy.sparse.csr_matrix((np.ones(count), (np.arange(count), self.at)), (count, self.buses))
        ends = np.arange(len(first)).repeat(2), self.lines.ravel()
        across = scipy.sparse.csr_matrix((np.tile([-1.0, 1.0], len(first)), ends), (len(first), self.buses))
        stiff = across.T @ scipy.sparse.diags(LINE * np.cos(theta[second] - theta[first])) @ across
        nothing, unit, slow = scipy.sparse.csr_matrix((count, count)), scipy.sparse.eye(count), 1 / self.inertia
        slow = scipy.sparse.diags(slow)
        f1w = scipy.sparse.bmat([[nothing, unit], [-slow @ pull, -slow @ scipy.sparse.diags(self.damping)]])
        f1z = scipy.sparse.bmat([[scipy.sparse.csr_matrix((count, self.buses))], [slow @ pull @ here]])
        f2w = scipy.sparse.bmat([[here.T @ pull, scipy.sparse.csr_matrix((self.buses, count))]])
        return f1w, f1z, f2w, (-here.T @ pull @ here - stiff).tocsc()

    def reduced(self, x):
        """∂θ/∂w (buses, d), and A of w' = A w, by a sparse LU factorisation."""
        f1w, f1z, f2w, f2z = self.jacobians(x)
        inverse_block = -scipy.sparse.linalg.splu(f2z).solve(f2w.toarray())
        return inverse_block, f1w.toarray() + f1z @ inverse_block

    def log_growth(self, length: float) -> np.ndarray:
        """Ln σ_i (d,) of the fundamental matrix at rest, on the tangent vectors [w; ∂θ/∂w w]."""
        inverse_block, a = self.reduced(self.rest)
        _, r = np.linalg.qr(np.vstack([np.eye(self.d), inverse_block]))
        moved = r @ scipy.linalg.expm(length * a) @ np.linalg.inv(r)
        return np.log(np.linalg.svd(moved, compute_uv=False))

    def _state(self, angles):
        count = len(self.at)
        delta, theta = np.concatenate([[0.0], angles[: count - 1]]), angles[count - 1 :]
        return np.concatenate([delta, np.zeros(count), theta])

    def _still(self, angles):
        """The equations of rest without that of the first generator, which follows from the balance of power."""
        x, count = self._state(angles), len(self.at)
        delta, theta = x[:count], x[2 * count :]
        given = COUPLING * np.sin(delta - theta[self.at])
        first, second = self.lines.T
        net, flow = np.full(self.buses, -LOAD), LINE * np.sin(theta[second] - theta[first])
        np.add.at(net, self.at, given)
        np.add.at(net, first, flow)
        np.add.at(net, second, -flow)
        return np.concatenate([(self.power - given)[1:], net])

    def _still_jacobian(self, angles):
        count = len(self.at)
        f1w, f1z, f2w, f2z = (part.toarray() for part in self.jacobians(self._state(angles)))
        above = self.inertia[:, None] * np.hstack([f1w[count:, :count], f1z[count:]])
        whole = np.vstack([above[1:], np.hstack([f2w[:, :count], f2z])])
        return whole[:, 1:]

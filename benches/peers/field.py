"""Gradient vector flow in Python: (b - mu Laplace) V = b grad f with b = |grad f|^2, seven points, lengths in mm, no flow through the faces.

All take the edge map's gradient and b as arrays [z, y, x] of f32 and return the three components of V. Time is what the caller measures;
what does not depend on the edge map (the Laplacian as a matrix) is made before and not counted.
"""

import numpy as np
import pyamg
import scipy.sparse as sparse
from numba import njit
from scipy.sparse.linalg import cg


class Problem:
    """The right-hand sides and the matrix's diagonal for an edge map on a grid."""

    def __init__(self, edges, spacing_mm, mu):
        self.mu = np.float32(mu)
        self.weights = (mu / np.square(np.array(spacing_mm))).astype(np.float32)
        along_z, along_y, along_x = np.gradient(edges, *spacing_mm)
        self.gradient = [component.astype(np.float32) for component in (along_x, along_y, along_z)]
        self.b = sum(component * component for component in self.gradient)
        self.right = [self.b * component for component in self.gradient]
        self.diagonal = self.b + diagonal_of_laplacian(edges.shape, self.weights)

    def residual(self, field):
        """The largest of the components' relative residuals, in the norm weighted by the inverse diagonal, in f64."""
        return max(self.residual_of(component, right) for component, right in zip(field, self.right))

    def residual_of(self, component, right):
        v = component.astype(np.float64)
        product = self.diagonal.astype(np.float64) * v
        for axis in range(3):
            low = [slice(None)] * 3
            high = [slice(None)] * 3
            low[axis], high[axis] = slice(None, -1), slice(1, None)
            product[tuple(low)] -= float(self.weights[axis]) * v[tuple(high)]
            product[tuple(high)] -= float(self.weights[axis]) * v[tuple(low)]
        rest = right - product
        return np.sqrt(np.sum(rest * rest / self.diagonal) / np.sum(right.astype(np.float64) ** 2 / self.diagonal))


def diagonal_of_laplacian(shape, weights):
    total = np.zeros(shape, np.float32)
    for axis, length in enumerate(shape):
        neighbours = np.full(length, 2, np.float32)
        neighbours[0] -= 1
        neighbours[-1] -= 1
        total += weights[axis] * neighbours.reshape([-1 if other == axis else 1 for other in range(3)])
    return total


# Rows are contiguous, so that the innermost loops vectorise; a neighbour beyond a face is the voxel itself, which is no flow.
@njit(fastmath=True, cache=True)
def explicit_step(v, new, b, right, weights, dt):
    nz, ny, nx = v.shape
    wz, wy, wx = weights[0], weights[1], weights[2]
    for z in range(nz):
        for y in range(ny):
            here, below, above = v[z, y], v[max(z - 1, 0), y], v[min(z + 1, nz - 1), y]
            before, after = v[z, max(y - 1, 0)], v[z, min(y + 1, ny - 1)]
            b_row, right_row, to = b[z, y], right[z, y], new[z, y]
            for x in range(1, nx - 1):
                u = here[x]
                flow = wz * (below[x] + above[x] - 2 * u) + wy * (before[x] + after[x] - 2 * u) + wx * (here[x - 1] + here[x + 1] - 2 * u)
                to[x] = u + dt * (flow + right_row[x] - b_row[x] * u)
            for x, beside in ((0, 1), (nx - 1, nx - 2)):
                u = here[x]
                flow = wz * (below[x] + above[x] - 2 * u) + wy * (before[x] + after[x] - 2 * u) + wx * (here[beside] - u)
                to[x] = u + dt * (flow + right_row[x] - b_row[x] * u)


@njit(cache=True)
def explicit_steps(v, other, b, right, weights, dt, steps):
    for _ in range(steps):
        explicit_step(v, other, b, right, weights, dt)
        v, other = other, v
    return v, other


def stable_step(problem, part=0.98):
    """A part of the largest step that explicit iteration bears."""
    return np.float32(part * 2.0 / float(np.max(problem.b) + 4 * np.sum(problem.weights)))


class Explicit:
    """Explicit iteration that can be gone on with."""

    def __init__(self, problem, dt):
        self.problem, self.dt, self.steps = problem, np.float32(dt), 0
        self.state = [(component.copy(), component.copy()) for component in problem.gradient]

    def advance(self, steps):
        problem = self.problem
        self.state = [
            explicit_steps(v, other, problem.b, right, problem.weights, self.dt, steps)
            for (v, other), right in zip(self.state, problem.right)
        ]
        self.steps += steps

    @property
    def field(self):
        return [v for v, _ in self.state]


@njit(fastmath=True, cache=True)
def apply(v, product, diagonal, weights):
    """product = A v; returns v . A v."""
    nz, ny, nx = v.shape
    wz, wy, wx = weights[0], weights[1], weights[2]
    total = 0.0
    for z in range(nz):
        for y in range(ny):
            here, d, to = v[z, y], diagonal[z, y], product[z, y]
            # A face has no neighbour beyond it: weight nought, and any row will do.
            w_below, w_above = wz if z > 0 else 0 * wz, wz if z < nz - 1 else 0 * wz
            w_before, w_after = wy if y > 0 else 0 * wy, wy if y < ny - 1 else 0 * wy
            below, above = v[max(z - 1, 0), y], v[min(z + 1, nz - 1), y]
            before, after = v[z, max(y - 1, 0)], v[z, min(y + 1, ny - 1)]
            row = np.float32(0)
            for x in range(1, nx - 1):
                beside = w_below * below[x] + w_above * above[x] + w_before * before[x] + w_after * after[x]
                p = d[x] * here[x] - beside - wx * (here[x - 1] + here[x + 1])
                to[x] = p
                row += p * here[x]
            for x, other in ((0, 1), (nx - 1, nx - 2)):
                beside = w_below * below[x] + w_above * above[x] + w_before * before[x] + w_after * after[x]
                p = d[x] * here[x] - beside - wx * here[other]
                to[x] = p
                row += p * here[x]
            total += row
    return total


@njit(fastmath=True, cache=True)
def update(solution, residual, direction, product, inverse, alpha):
    """Moves along the direction; returns r . r / D."""
    s, r, d, p, i = solution.ravel(), residual.ravel(), direction.ravel(), product.ravel(), inverse.ravel()
    total = 0.0
    for start in range(0, s.size, 4096):
        part = np.float32(0)
        for k in range(start, min(start + 4096, s.size)):
            s[k] += alpha * d[k]
            rest = r[k] - alpha * p[k]
            r[k] = rest
            part += rest * rest * i[k]
        total += part
    return total


@njit(fastmath=True, cache=True)
def redirect(direction, residual, inverse, beta):
    d, r, i = direction.ravel(), residual.ravel(), inverse.ravel()
    for k in range(d.size):
        d[k] = r[k] * i[k] + beta * d[k]


@njit(cache=True)
def conjugate_gradients(right, start, diagonal, inverse, weights, tolerance, most):
    solution = start.copy()
    product = np.empty_like(right)
    apply(solution, product, diagonal, weights)
    residual = right - product
    direction = residual * inverse
    scale = np.sqrt(np.sum(right * right * inverse))
    rz = np.sum(residual * residual * inverse)
    iterations = 0
    while np.sqrt(rz) > tolerance * scale and iterations < most:
        alpha = np.float32(rz / apply(direction, product, diagonal, weights))
        following = update(solution, residual, direction, product, inverse, alpha)
        redirect(direction, residual, inverse, np.float32(following / rz))
        rz = following
        iterations += 1
    return solution, iterations


def numba_cg(problem, tolerance):
    """Conjugate gradients with the diagonal as preconditioner, f32, loops fused and compiled by numba."""
    inverse = 1 / problem.diagonal
    solved = [
        conjugate_gradients(right, start, problem.diagonal, inverse, problem.weights, tolerance, 4000)
        for right, start in zip(problem.right, problem.gradient)
    ]
    return [solution for solution, _ in solved], [iterations for _, iterations in solved]


def laplacian(shape, weights):
    """-mu Laplace as a sparse matrix, the part that does not depend on the edge map."""

    def along(length):
        ends = np.full(length, 2.0)
        ends[[0, -1]] = 1
        return sparse.diags([-np.ones(length - 1), ends, -np.ones(length - 1)], [-1, 0, 1])

    one = [sparse.identity(length) for length in shape]
    parts = [[along(length) * float(weights[axis]) if other == axis else one[other] for other in range(3)] for axis, length in enumerate(shape)]
    return sum(sparse.kron(sparse.kron(a, b), c) for a, b, c in parts).tocsr()


def scipy_cg(problem, minus_laplace, tolerance):
    """scipy's conjugate gradients in f32 on the matrix scaled by its diagonal from both sides, whose plain norm is the weighted one."""
    root = np.sqrt(problem.diagonal).ravel()
    scaling = sparse.diags((1 / root).astype(np.float32))
    scaled = (scaling @ (minus_laplace + sparse.diags(problem.b.ravel())).astype(np.float32) @ scaling).tocsr().astype(np.float32)
    field, iterations = [], []
    for right, start in zip(problem.right, problem.gradient):
        count = [0]

        def counted(_, count=count):
            count[0] += 1

        y, _ = cg(scaled, right.ravel() / root, x0=start.ravel() * root, rtol=tolerance, maxiter=4000, callback=counted)
        field.append((y / root).reshape(right.shape))
        iterations.append(count[0])
    return field, iterations


def pyamg_cg(problem, minus_laplace, tolerance):
    """Conjugate gradients preconditioned by algebraic multigrid (Ruge-Stueben of pyamg), on the scaled matrix, set up once for three solves."""
    root = np.sqrt(problem.diagonal.astype(np.float64)).ravel()
    scaling = sparse.diags(1 / root)
    matrix = (scaling @ (minus_laplace + sparse.diags(problem.b.ravel().astype(np.float64))) @ scaling).tocsr()
    levels = pyamg.ruge_stuben_solver(matrix)
    field, iterations = [], []
    for right, start in zip(problem.right, problem.gradient):
        norms = []
        y = levels.solve(right.ravel() / root, x0=start.ravel() * root, tol=tolerance, accel="cg", residuals=norms)
        field.append((y / root).reshape(right.shape).astype(np.float32))
        iterations.append(len(norms) - 1)
    return field, iterations

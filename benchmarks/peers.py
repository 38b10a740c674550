"""What a user would pick instead: each solver as a function of the fields.

Each stops at the loosest tolerance, in powers of ten, that leaves its cost within 1e-8 of the lowest at every size, so
that nobody pays for digits that the others do not give.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from problem import START, Fields, compiled_jacobian, compiled_residuals, residuals

SCIPY, CERES, OPTIMISTIX, JAXOPT = 1e-5, 1e-8, 1e-4, 1e-4


def scipy_lm(data: Fields) -> np.ndarray:
    """SciPy's Levenberg-Marquardt (MINPACK) with the exact Jacobian."""
    import scipy.optimize

    return scipy.optimize.least_squares(
        lambda theta: np.asarray(compiled_residuals(theta, data)),
        START,
        jac=lambda theta: np.asarray(compiled_jacobian(theta, data)),  # pyright: ignore[reportArgumentType]
        method="lm",
        ftol=SCIPY,
        xtol=SCIPY,
        gtol=SCIPY,
    ).x


def ceres(data: Fields) -> np.ndarray:
    """Ceres through pyceres: Levenberg-Marquardt on dense normal equations, all threads, with the exact Jacobian."""
    import pyceres

    count = 3 * data.n_l.shape[0]

    class Cost(pyceres.CostFunction):
        def __init__(self):
            super().__init__()
            self.set_num_residuals(count)
            self.set_parameter_block_sizes([12])

        def Evaluate(self, parameters, out, jacobians):  # noqa: N802
            theta = jnp.asarray(parameters[0])
            out[:] = np.asarray(compiled_residuals(theta, data))
            if jacobians is not None:
                jacobians[0][:] = np.asarray(compiled_jacobian(theta, data)).reshape(-1)
            return True

    theta = START.copy()
    problem, options, summary = pyceres.Problem(), pyceres.SolverOptions(), pyceres.SolverSummary()
    problem.add_residual_block(Cost(), None, [theta])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_NORMAL_CHOLESKY
    options.function_tolerance = options.parameter_tolerance = CERES
    options.gradient_tolerance = 1e-12
    options.max_num_iterations = 200
    options.num_threads = os.cpu_count() or 1
    options.minimizer_progress_to_stdout = False
    options.logging_type = pyceres.LoggingType.SILENT
    pyceres.solve(options, problem, summary)
    return theta


def _optimistix(data: Fields, linear_solver: str) -> np.ndarray:
    import lineax as lx
    import optimistix as optx

    linear = {"qr": lx.QR(), "cholesky": lx.Normal(lx.Cholesky())}[linear_solver]
    solver = optx.LevenbergMarquardt(OPTIMISTIX, OPTIMISTIX, norm=optx.rms_norm, linear_solver=linear)
    return np.asarray(optx.least_squares(residuals, solver, jnp.asarray(START), data, max_steps=300, throw=False).value)


def optimistix_qr(data: Fields) -> np.ndarray:
    """optimistix's Levenberg-Marquardt, by QR."""
    return _optimistix(data, "qr")


def optimistix_cholesky(data: Fields) -> np.ndarray:
    """optimistix's Levenberg-Marquardt, by Cholesky on the normal equations."""
    return _optimistix(data, "cholesky")


def jaxopt_lm(data: Fields) -> np.ndarray:
    """jaxopt's Levenberg-Marquardt, by Cholesky."""
    global _jaxopt_run
    if _jaxopt_run is None:
        import jaxopt

        solver = jaxopt.LevenbergMarquardt(
            residuals, solver="cholesky", materialize_jac=True, tol=JAXOPT, xtol=JAXOPT, gtol=JAXOPT, maxiter=200
        )
        _jaxopt_run = jax.jit(lambda data: solver.run(jnp.asarray(START), data).params)
    return np.asarray(_jaxopt_run(data))


_jaxopt_run: Callable | None = None


def adam(data: Fields) -> np.ndarray:
    """Adam, 500 steps, learning rate 0.05 with a cosine schedule, on the mean of squares."""
    global _adam_run
    if _adam_run is None:
        import optax

        rule = optax.adam(optax.cosine_decay_schedule(0.05, 500))

        def run(data: Fields) -> jax.Array:
            gradient = jax.grad(lambda theta: jnp.mean(residuals(theta, data) ** 2))

            def step(_: int, state: tuple) -> tuple:
                theta, memory = state
                change, memory = rule.update(gradient(theta), memory)
                return optax.apply_updates(theta, change), memory

            return jax.lax.fori_loop(0, 500, step, (jnp.asarray(START), rule.init(jnp.asarray(START))))[0]

        _adam_run = jax.jit(run)
    return np.asarray(_adam_run(data))


_adam_run: Callable | None = None

PEERS = {
    "SciPy least_squares lm, exact Jacobian": scipy_lm,
    "Ceres (pyceres), exact Jacobian": ceres,
    "optimistix LM, QR": optimistix_qr,
    "optimistix LM, Normal(Cholesky)": optimistix_cholesky,
    "jaxopt LM, Cholesky": jaxopt_lm,
    "Adam, 500 steps": adam,
}

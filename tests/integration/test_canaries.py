"""Two ways in which known bad versions of JAX fail. Each runs alone, with a time limit.

The versions are refused by ``jaxplan.versions`` already; these tests tell when a new one goes bad.
"""

import subprocess
import sys

import pytest

# jax#39103 (reproduced from its description): on jax 0.10.2 the compiled squared norm of matrix-vector
# products over more rows than one block is wrong, without any warning.
WRONG_RESULT = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", {x64})
radius = np.arange({rows}, dtype={dtype!r})
vectors = np.stack([radius, 0.0 * radius, 0.0 * radius], axis=1)
rotation = jnp.eye(3, dtype={dtype!r})
squared_norms = jax.vmap(lambda vector: jnp.sum((rotation @ vector) ** 2))
compiled = np.asarray(jax.jit(squared_norms)(vectors))
np.testing.assert_array_equal(compiled, radius**2)
print("right")
"""

# Two independent batched LAPACK calls in one program wait for each other for ever on few cores.
HANG = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
random = np.random.default_rng(0)
a, b = (random.normal(size=(400, 12, 12)) + 12.0 * np.eye(12) for _ in range(2))
identity = np.broadcast_to(np.eye(12), a.shape)
symmetric = lambda m: m @ jnp.swapaxes(m, -1, -2)
calls = {{
    "solve": lambda m: jnp.linalg.solve(m, identity),
    "inv": jnp.linalg.inv,
    "cholesky": lambda m: jnp.linalg.cholesky(symmetric(m)),
    "qr": lambda m: jnp.linalg.qr(m)[1],
    "solve_triangular": lambda m: jax.scipy.linalg.solve_triangular(m, identity, lower=True),
}}
call = calls[{name!r}]
both = jax.jit(lambda a, b: (call(a), call(b)))
for _ in range({repeats}):
    jax.block_until_ready(both(a, b))
print("right")
"""


def run_alone(code: str, limit: float) -> None:
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        pytest.fail(f"this version of JAX hung for {limit:g} s; see docs/decisions/0001-jax-versions.md")
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip().endswith("right")


@pytest.mark.parametrize(("dtype", "rows", "x64"), [("float64", 16_385, True), ("float32", 32_769, False)])
def test_compiled_squared_norms_are_right(dtype: str, rows: int, x64: bool) -> None:
    run_alone(WRONG_RESULT.format(dtype=dtype, rows=rows, x64=x64), limit=60.0)


@pytest.mark.parametrize("name", ["solve", "inv", "cholesky", "qr", "solve_triangular"])
def test_two_batched_lapack_calls_in_one_program_return(name: str) -> None:
    run_alone(HANG.format(name=name, repeats=20), limit=60.0)

"""How many programs XLA compiles; the fixture ``compilations`` counts a test's."""


class CompilationCounter:
    """A listener of JAX's monitoring; ``count`` can be set back to 0."""

    EVENT = "/jax/core/compile/backend_compile_duration"

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, event: str, duration: float, **kwargs: object) -> None:
        self.count += event == self.EVENT

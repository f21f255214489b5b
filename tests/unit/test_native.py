"""The key of what numba keeps on disk."""

import pytest

from jaxplan.native import digest_of
from jaxplan.optimizer.kernels import compiled as of_optimizer
from jaxplan.search.kernels import compiled as of_search
from jaxplan.tracking.kernels import compiled as of_tracking


@pytest.mark.parametrize("compiled", [of_search, of_tracking])
def test_the_cache_key_follows_every_source_file(compiled, tmp_path):
    folder = compiled.Path(compiled.__file__).parent
    for path in sorted(folder.glob("*.py")):
        (tmp_path / path.name).write_bytes(path.read_bytes())
        before = digest_of.__wrapped__(tmp_path)
        (tmp_path / path.name).write_bytes(path.read_bytes() + b"\n")
        assert digest_of.__wrapped__(tmp_path) != before
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert digest_of.__wrapped__(tmp_path) == compiled.source_digest() == digest_of(folder)


def test_each_has_a_key_of_its_own():
    assert of_search.source_digest() != of_tracking.source_digest()


def test_the_key_of_the_descent_follows_all_that_it_calls():
    own = digest_of(of_optimizer.Path(of_optimizer.__file__).parent)
    assert of_optimizer.source_digest() == own + of_search.source_digest() + of_tracking.source_digest()

"""The key of what numba keeps on disk."""

import pytest

from jaxplan.native import digest_of
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


def test_the_two_have_keys_of_their_own():
    assert of_search.source_digest() != of_tracking.source_digest()

"""Target models as files: what is shipped, and that whatever is damaged is refused."""

import hashlib
import json
import shutil

import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import (
    TargetModel,
    card_path,
    check_model,
    load_model,
    save_model,
    shipped_model,
    window_coordinates,
)
from jaxplan.world.load import load_world
from tolerances import tolerance

SHIPPED = [("env1", 0.1), ("env2", 0.2), ("env3", 0.2), ("somewhere.stl", 0.1), ("somewhere.stl", 0.2)]


def small_model(observations=3, steps=2, anchored=True):
    rng = np.random.default_rng(0)
    size = 3 * (observations - 1 + anchored + steps)
    matrices = rng.standard_normal((2, size, size))
    return TargetModel(
        name="small",
        observations=observations,
        steps=steps,
        dt=0.1,
        bounds=np.array([[-5.0, -5.0, 0.0], [5.0, 5.0, 2.0]]) if anchored else None,
        weights=np.array([0.25, 0.75]),
        means=rng.standard_normal((2, size)),
        factors=np.linalg.cholesky(matrices @ matrices.swapaxes(1, 2) + np.eye(size)),
    )


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "small.npy"
    save_model(small_model(), path, {"seed": 0})
    return path


def rewrite(path, **changes):
    """Change the card."""
    card = json.loads(card_path(path).read_text())
    card_path(path).write_text(json.dumps({**card, **changes}))


def restore(path, table):
    """Another array under a card that vouches for it."""
    np.save(path, table)
    rewrite(path, sha256=hashlib.sha256(path.read_bytes()).hexdigest())


@pytest.mark.parametrize("anchored", [True, False])
def test_what_is_saved_is_what_is_loaded(tmp_path, anchored):
    model = small_model(anchored=anchored)
    save_model(model, tmp_path / "m.npy", {"seed": 0})
    loaded = load_model(tmp_path / "m.npy")
    assert (loaded.name, loaded.observations, loaded.steps, loaded.dt) == ("small", 3, 2, 0.1)
    assert loaded.observed == (9 if anchored else 6)
    for name in ("weights", "means", "factors"):
        np.testing.assert_allclose(getattr(loaded, name), getattr(model, name), **tolerance("solve"))
    assert (loaded.bounds is None) == (not anchored)


def test_coordinates_of_a_window():
    window = np.arange(15.0).reshape(5, 3) ** 2
    relative = window_coordinates(window, 3, anchored=False)
    np.testing.assert_array_equal(relative, (window[[0, 1, 3, 4]] - window[2]).reshape(-1))
    anchored = window_coordinates(window, 3, anchored=True)
    np.testing.assert_array_equal(anchored, [*window[2], *relative])
    np.testing.assert_array_equal(window_coordinates(window[:3], 3, anchored=True), anchored[:9])


@pytest.mark.parametrize(("world", "dt"), SHIPPED)
def test_shipped_models_say_where_they_come_from(world, dt):
    model = shipped_model(world, dt)
    known = load_world(world) if world.startswith("env") else None
    check_model(model, observations=10, steps=20, dt=dt, world=known)
    assert (model.bounds is None) == (known is None)
    assert model.name == (world if known else "generic")


def test_cards_have_command_seed_hash_and_scores(repository):
    paths = sorted((repository / "jaxplan" / "prediction" / "models").glob("*.npy"))
    assert len(paths) == 5
    for path in paths:
        card = json.loads(card_path(path).read_text())
        assert card["command"].startswith("jaxplan train gmm")
        assert len(card["data_sha256"]) == 64
        assert {"seed", "held_out_log_likelihood", "versions"} <= set(card)
        scores, share = card["held_out_scores"], 0.9 if card["bounds"] is None else 0.7
        assert scores["gmm"]["fde_m"] < share * scores["constant-velocity"]["fde_m"]
        assert path.stat().st_size < 1e6


def test_no_model_for_an_unusual_interval():
    with pytest.raises(InputError, match="train one"):
        shipped_model("env1", 0.37)


DAMAGE = {
    "a flipped bit": (lambda p: p.write_bytes(p.read_bytes()[:-1] + b"\x01"), "vouches"),
    "a truncated array": (lambda p: p.write_bytes(p.read_bytes()[:200]), "vouches"),
    "no array": (lambda p: p.unlink(), "no such file"),
    "no card": (lambda p: card_path(p).unlink(), "no such file"),
    "a card that is no JSON": (lambda p: card_path(p).write_text("{"), "no JSON"),
    "a card that is a list": (lambda p: card_path(p).write_text("[]"), "format"),
    "another version": (lambda p: rewrite(p, format="jaxplan target model 0"), "target model 0"),
    "no steps": (lambda p: rewrite(p, steps=None), "counts"),
    "more steps than there are": (lambda p: rewrite(p, steps=7), "shape"),
    "dt of minus one": (lambda p: rewrite(p, dt=-1.0), "dt"),
    "half a room": (lambda p: rewrite(p, bounds=[[0, 0, 0]]), "bounds"),
    "no hash": (lambda p: rewrite(p, sha256=None), "sha256"),
    "text instead of an array": (lambda p: (p.write_text("hello"), restore_hash(p)), "NumPy"),
    "another shape": (lambda p: restore(p, np.ones((2, 3), np.float32)), "shape"),
    "another precision": (lambda p: restore(p, np.load(p).astype(float)), "float64"),
    "NaN": (lambda p: restore(p, np.load(p) * np.float32(np.nan)), "finite"),
    "weights of 2": (lambda p: restore(p, np.load(p) * np.float32(2.0)), "sum to 1"),
    "a negative diagonal": (lambda p: restore(p, flipped(np.load(p))), "diagonal"),
}


def restore_hash(path):
    rewrite(path, sha256=hashlib.sha256(path.read_bytes()).hexdigest())


def flipped(table):
    table[0, -1] *= -1.0
    return table


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_is_refused_with_its_reason(saved, kind):
    damage, said = DAMAGE[kind]
    damage(saved)
    with pytest.raises(FileError, match=said):
        load_model(saved)


def test_a_model_that_is_not_there_is_called_by_the_name_that_was_given(tmp_path):
    with pytest.raises(FileError, match=r"absent\.npy: no such file"):
        load_model(tmp_path / "absent.npy")


def test_random_damage_never_escapes_as_another_error(saved, tmp_path):
    """200 random cuts and overwrites of either file: refused, or harmless."""
    rng = np.random.default_rng(0)
    for index in range(200):
        copy = tmp_path / f"copy{index}.npy"
        shutil.copy(saved, copy)
        shutil.copy(card_path(saved), card_path(copy))
        victim = copy if index % 2 else card_path(copy)
        data = bytearray(victim.read_bytes())
        place = int(rng.integers(len(data)))
        victim.write_bytes(data[:place] if index % 4 < 2 else data[:place] + rng.bytes(1) + data[place + 1 :])
        try:
            load_model(copy)
        except FileError:
            continue


@pytest.mark.parametrize(
    ("wanted", "said"), [({"dt": 0.2}, "dt"), ({"steps": 5}, "steps"), ({"observations": 10}, "observations")]
)
def test_a_model_for_other_windows_is_refused(saved, wanted, said):
    config = PredictionConfig(**{"steps": 2, "observations": 3, "dt": 0.1, **wanted})
    with pytest.raises(InputError, match=said):
        build_predictor("gmm", config, model=load_model(saved))


def test_a_model_of_another_room_is_refused(saved):
    config = PredictionConfig(steps=2, observations=3)
    build_predictor("gmm", config, model=load_model(saved), world=load_world("env1"))
    with pytest.raises(InputError, match="another"):
        build_predictor("gmm", config, model=load_model(saved), world=load_world("env2"))
    with pytest.raises(InputError, match="observations"):  # those of the generic one
        build_predictor("gmm", config)

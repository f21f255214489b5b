"""One function of many numbers on a cluster of this machine: all come back, and what goes wrong is named."""

import operator
import os

import pytest

from jaxplan import cli
from jaxplan.errors import ResourceError
from jaxplan.runner.connection import connect
from jaxplan.runner.distribute import map_on_workers

pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")


def test_all_numbers_come_back_with_what_was_made_of_them():
    assert dict(map_on_workers(operator.neg, [3, 1, 4, 5], workers=2)) == {3: -3, 1: -1, 4: -4, 5: -5}


def test_an_error_of_the_function_is_its_own():
    with pytest.raises(ValueError, match="negative shift count"):
        list(map_on_workers((1).__lshift__, [2, -1], workers=1))


def test_a_task_that_kills_its_workers_is_given_up_by_name():
    with pytest.raises(ResourceError, match="workers died over number 7"):
        list(map_on_workers(os._exit, [7], workers=1))


def test_a_cluster_of_this_machine_listens_to_nobody_else():
    with connect(1, None):
        here = psutil.Process()
        listening = [
            one.laddr.ip
            for process in (here, *here.children(recursive=True))
            for one in process.net_connections(kind="inet")
            if one.status == psutil.CONN_LISTEN
        ]
    assert listening
    assert set(listening) == {"127.0.0.1"}


def test_a_scheduler_that_is_not_there_is_named(tmp_path, capsys):
    wanted = ["--out", str(tmp_path / "data"), "--shards", "1", "--scheduler", "tcp://127.0.0.1:9"]
    assert cli.run(["train", "dataset", *wanted]) == 12
    assert "tcp://127.0.0.1:9: no answer" in capsys.readouterr().err

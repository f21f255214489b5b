"""The clock that the firmware runs under, around a small program that looks at time and talks as the firmware does."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from experiments.betaflight import build, process
from experiments.betaflight.link import Link, Sensors, Sticks

for tool in build.NEEDED:
    if shutil.which(tool) is None:
        pytest.skip(f"needs {tool}", allow_module_level=True)

STICKS = Sticks(1500, 1500, 1000, 1500, armed=False)
METRONOME = r"""
#include <arpa/inet.h>
#include <pthread.h>
#include <string.h>
#include <sys/select.h>
#include <time.h>
#include <unistd.h>

static double heard[2]; /* time stamps of state and radio */
static int in[2], out;
static struct sockaddr_in peer;

static void motors(float a, float b, float c, float d)
{
    float packet[4] = {a, b, c, d};
    sendto(out, packet, sizeof packet, 0, (struct sockaddr *)&peer, sizeof peer);
}

static void *listener(void *argument)
{
    long which = (long)argument;
    int fd = in[which];
    for (;;) {
        char packet[256];
        struct timeval patience = {0, 100000};
        fd_set set;
        FD_ZERO(&set);
        FD_SET(fd, &set);
        if (select(fd + 1, &set, 0, 0, &patience) != 1) continue;
        recvfrom(fd, packet, sizeof packet, 0, 0, 0);
        usleep(which ? 3000 : 0); /* slow to deal with it: time must wait */
        memcpy(&heard[which], packet, sizeof(double));
        motors(-1, -1, -1, -1); /* of another thread: must not arrive */
    }
    return 0;
}

int main(void)
{
    pthread_t threads[2];
    struct timespec now, nap = {0, 50000};
    float steps = 0;
    out = socket(AF_INET, SOCK_DGRAM, 0);
    peer = (struct sockaddr_in){.sin_family = AF_INET, .sin_port = htons(9002)};
    peer.sin_addr.s_addr = inet_addr("127.0.0.1");
    for (long i = 0; i < 2; i++) {
        struct sockaddr_in any = {.sin_family = AF_INET, .sin_port = htons(9003 + i)};
        in[i] = socket(AF_INET, SOCK_DGRAM, 0);
        bind(in[i], (struct sockaddr *)&any, sizeof any);
        pthread_create(&threads[i], 0, listener, (void *)i);
    }
    for (;;) {
        clock_gettime(CLOCK_MONOTONIC, &now);
        nanosleep(&nap, 0);
        motors(now.tv_sec + 1e-9 * now.tv_nsec, heard[0], heard[1], ++steps);
    }
}
"""


@pytest.fixture(scope="module")
def metronome(tmp_path_factory: pytest.TempPathFactory) -> build.Firmware:
    folder = tmp_path_factory.mktemp("metronome")
    (folder / "metronome.c").write_text(METRONOME)
    program = folder / "metronome"
    subprocess.run(["gcc", "-O1", "-o", program, folder / "metronome.c", "-lpthread"], check=True)
    build.compile_clock(folder / "clock.so")
    return build.Firmware(program, folder / "clock.so")


def ticked(metronome: build.Firmware, folder: Path, count: int) -> np.ndarray:
    """The answers to steps of 2.5 ms from 3 s on."""
    rest = Sensors(np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    with process.running(metronome, folder, 3.0) as there:
        link = Link(there)
        answers = [link.step(3.0 + 0.0025 * step, rest, STICKS) for step in range(1, count + 1)]
        assert there.process.poll() is None
        there.sockets.inbound.settimeout(0.05)
        with pytest.raises(TimeoutError):  # one answer for each pair, and then it waits
            there.sockets.inbound.recv(64)
    return np.array(answers)


def test_time_stands_between_steps_and_two_runs_are_the_same(metronome: build.Firmware, tmp_path: Path) -> None:
    """Each step sees the packets of that step, runs 2.5 ms, and no further."""
    answers = ticked(metronome, tmp_path, 40)
    stamps = 3.0 + 0.0025 * np.arange(1, 41)
    late = stamps - answers[:, 0]
    single = 1e-6  # time arrives in single precision
    assert (late > -single).all()
    assert (late < 2.0 * 51e-6 + single).all()  # a nap and a look, at most twice
    np.testing.assert_allclose(answers[:, 1:3], stamps[:, None] * np.ones(2), rtol=0.0, atol=single)
    per_step = np.diff(answers[:, 3])
    assert set(per_step.tolist()) <= {49.0, 50.0}  # 2.5 ms of 51 us each
    assert answers[0, 3] == pytest.approx((3.0025) / 51e-6, rel=1e-3)  # from 0: the boot is on the same clock
    np.testing.assert_array_equal(ticked(metronome, tmp_path, 40), answers)


def test_it_listens_to_this_machine_alone(metronome: build.Firmware, tmp_path: Path) -> None:
    with process.running(metronome, tmp_path, 3.0) as there:
        Link(there)
        lines = Path(f"/proc/{there.process.pid}/net/udp").read_text().splitlines()[1:]
    local = {line.split()[1] for line in lines}
    # addresses in the machine's byte order; with a network of its own there is nothing else
    assert {"0100007F:232B", "0100007F:232C"} <= local  # 9003 and 9004
    assert not {"00000000:232B", "00000000:232C"} & local


def test_it_dies_with_whoever_started_it(metronome: build.Firmware, tmp_path: Path) -> None:
    """Also where that one is killed and cleans nothing up."""
    text = (
        "import sys, time\nfrom pathlib import Path\nfrom experiments.betaflight import build, process\n"
        "made = build.Firmware(Path(sys.argv[1]), Path(sys.argv[2]))\n"
        "with process.running(made, Path(sys.argv[3]), 3.0) as there:\n"
        "    there.sockets.inbound.recv(64)\n    print(there.process.pid, flush=True)\n    time.sleep(60)\n"
    )
    line = [sys.executable, "-c", text, metronome.program, metronome.clock, tmp_path]
    starter = subprocess.Popen(line, stdout=subprocess.PIPE, text=True)
    assert starter.stdout is not None
    number = int(starter.stdout.readline())
    os.kill(number, 0)
    starter.send_signal(signal.SIGKILL)
    starter.communicate()
    until = time.monotonic() + 10.0
    while time.monotonic() < until and is_there(number):
        time.sleep(0.01)
    assert not is_there(number)


def is_there(number: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has waited for does not."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False

"""The streamer: setpoints at an even rate, from before the autopilot obeys until it has held the end.

One thread: between two setpoints it waits for what comes in. It asks the flight for a setpoint and never waits for it.
"""

import select
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from jaxplan.errors import ResourceError
from jaxplan.mavlink.autopilot import Autopilot, Seen, TargetVehicle
from jaxplan.mavlink.codec import ARM, GPS_GLOBAL_ORIGIN, REQUEST_MESSAGE, SET_MODE, Codec
from jaxplan.mavlink.endpoint import Endpoint
from jaxplan.mavlink.flights import Flight
from jaxplan.mavlink.frames import to_ned
from jaxplan.mavlink.records import Phase, StreamConfig, StreamReport, Tell, tell_nobody

COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER."""
BEFORE_MODE = 1.5
"""Seconds of streaming before the autopilot is asked to obey: PX4 wants more than 1."""
_HEARTBEAT = 1.0
_ASK_AGAIN = 1.0
"""Seconds from one request to the next."""
_CLOSE, _SLOW = 0.3, 0.3
"""m and m/s: nearer and slower than these the vehicle is at the start (arbitrary)."""
_GRACE = 5.0
_SILENT = 3.0
"""Seconds without a heartbeat after which the autopilot counts as silent (arbitrary)."""
_REMEMBERED = 200_000
"""Gaps and distances that are kept: an hour at 50 a second."""
OVER = (Phase.DONE, Phase.RELEASED)


class Streamer:
    """Streams a flight to an autopilot. ``step`` does what is due; ``run`` does so until all is over."""

    def __init__(
        self,
        link: Endpoint,
        flight: Flight,
        config: StreamConfig | None = None,
        *,
        target: TargetVehicle | None = None,
        target_link: Endpoint | None = None,
        tell: Tell = tell_nobody,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """What is streamed where.

        Args:
            link: to the autopilot.
            flight: what is streamed.
            config: how.
            target: another vehicle whose place the flight is told.
            target_link: where it is heard, besides ``link``.
            tell: told what happens.
            clock: seconds, never backwards.

        Raises:
            ResourceError: pymavlink is not installed.
        """
        self.config = config or StreamConfig()
        self._codec = Codec(self.config.system, COMPONENT)
        other = None if target is None else target.system
        self.autopilot = Autopilot(np.asarray(self.config.origin, dtype=float), other)
        self.phase = Phase.CONNECTING
        self._link, self._flight, self._target, self._tell = link, flight, target, tell
        self._links = [link] if target_link is None else [link, target_link]
        self._clock, self._epoch = clock, clock()
        self._since = self._next = self._next_heartbeat = self._next_request = 0.0
        self._streaming = np.inf
        """Since when setpoints are streamed [s]."""
        self._asking = np.inf
        """Since when the autopilot is asked to obey [s]."""
        self._last_sent, self._silent, self._reason = np.nan, False, ""
        self._sent = self._lost = 0
        self._gaps: deque[float] = deque(maxlen=_REMEMBERED)
        self._off: deque[float] = deque(maxlen=_REMEMBERED)

    @property
    def now(self) -> float:
        """Seconds since the streamer was made."""
        return self._clock() - self._epoch

    def run(self) -> StreamReport:
        """Until it is over.

        Raises:
            ResourceError: the autopilot is silent, unknown, refuses, is too far off, or does not say where it is.
        """
        while self.phase not in OVER:
            wait = self.step()
            if wait > 0.0:
                select.select(self._links, [], [], wait)
        return self.report()

    def step(self) -> float:
        """Take in what has come, send what is due; seconds until there is something to send. Raises as ``run``."""
        self._hear()
        now = self.now
        self._advance(now)
        if now >= self._next_heartbeat:
            self._link.send(self._codec.heartbeat())
            self._next_heartbeat = now + _HEARTBEAT
        if now >= self._next_request:
            self._request(now)
            self._next_request = now + _ASK_AGAIN
        if now >= self._next:
            if self.autopilot.kind is not None:
                self._stream(now)
            # On the grid where that is ahead, and never two at once to make up for what is late.
            self._next = max(self._next + 1.0 / self.config.rate, now + 0.5 / self.config.rate)
        return min(self._next, self._next_heartbeat) - self.now

    def report(self) -> StreamReport:
        """What came of it so far."""
        gaps, off = np.array(self._gaps), np.array(self._off)
        return StreamReport(self.phase, self._reason, self._sent, self._lost, gaps, off, self._codec.damaged)

    def _hear(self) -> None:
        """Everything that has come, to whom it concerns."""
        before = self._seen
        for link in self._links:
            for datagram in link.receive():
                for message in self._codec.decode(datagram):
                    if link is self._link:
                        self.autopilot.hear(message, self.now)
                    if self._target is not None:
                        self._target.hear(message, self.now, self.autopilot)
        vehicle, target = (new if new is not old else None for new, old in zip(self._seen, before, strict=True))
        if vehicle is not None or target is not None:
            self._flight.tell(self.now, vehicle, target)

    @property
    def _seen(self) -> tuple[Seen | None, Seen | None]:
        """Vehicle and target, as last heard."""
        return self.autopilot.vehicle, None if self._target is None else self._target.seen

    def _stream(self, now: float) -> None:
        """The setpoint of this instant, and how far the vehicle is off it."""
        setpoint, autopilot = self._flight.setpoint(now), self.autopilot
        target = to_ned(setpoint, np.asarray(self.config.origin))
        went = self._link.send(self._codec.setpoint(now, autopilot.system, autopilot.component, target))
        self._sent, self._lost = self._sent + went, self._lost + (not went)
        self._streaming = min(self._streaming, now)
        if np.isfinite(self._last_sent):
            self._gaps.append(now - self._last_sent)
        self._last_sent = now
        vehicle = autopilot.where(now)
        if self.phase is Phase.FLYING and vehicle is not None:
            self._off.append(float(np.linalg.norm(vehicle.position - setpoint.position)))

    def _request(self, now: float) -> None:
        """Ask to obey, in the end to hold by itself, and where on the globe it counts from: what is needed of it."""
        autopilot = self.autopilot
        if autopilot.kind is None:
            return
        to = autopilot.system, autopilot.component
        if self._target is not None and self._target.by_globe and autopilot.reference is None:
            self._link.send(self._codec.command(*to, REQUEST_MESSAGE, GPS_GLOBAL_ORIGIN))
        if self.config.engage and self.phase is Phase.READY and self._may_engage(now):
            self._asking = min(self._asking, now)
            if now - self._asking > self.config.patience:
                have = autopilot.denied or "no answer"
                raise ResourceError(f"autopilot: have {have}, want {self._mode} and armed; see its own messages")
            if not autopilot.kind.obeys(autopilot.custom_mode):
                self._link.send(self._codec.command(*to, SET_MODE, *autopilot.kind.parameters))
            else:
                self._link.send(self._codec.command(*to, ARM, 1.0))
        if self._held(now) and self.config.engage and autopilot.kind.hold is not None:
            self._link.send(self._codec.command(*to, SET_MODE, *autopilot.kind.hold))

    def _may_engage(self, now: float) -> bool:
        """Whether it was streamed for long enough, to a vehicle that is not too far off, of a flight that can begin."""
        vehicle = self.autopilot.where(now)
        if now - self._streaming < BEFORE_MODE or vehicle is None or not self._flight.is_ready():
            return False
        self._refuse_far(vehicle, now)
        return True

    def _advance(self, now: float) -> None:
        """From phase to phase."""
        autopilot, phase = self.autopilot, self.phase
        if phase is Phase.CONNECTING:
            self._connect(now)
        elif phase is Phase.READY:
            self._give_up_without_position(now)
            vehicle = autopilot.where(now)
            if autopilot.engaged and vehicle is not None:
                self._refuse_far(vehicle, now)
                self._enter(Phase.APPROACHING, now)
        elif phase is Phase.HOLDING and not autopilot.engaged:
            self._enter(Phase.DONE, now)
        elif phase not in OVER and not autopilot.engaged:
            self._reason = f"the autopilot left {self._mode} {now - self._since:.1f} s after it began {phase.value}"
            self._enter(Phase.RELEASED, now)
        elif phase is Phase.APPROACHING:
            self._approach(now)
        elif phase is Phase.FLYING and self._flight.over(now):
            self._enter(Phase.HOLDING, now)
        elif phase is Phase.HOLDING and self._held(now - self._grace):
            self._enter(Phase.DONE, now)
        self._notice_silence(now)

    def _connect(self, now: float) -> None:
        kind = self.autopilot.kind
        if kind is not None:
            self._tell(now, f"{kind.name} is there, system {self.autopilot.system}")
            self._enter(Phase.READY, now)
        elif now > self.config.patience:
            raise ResourceError(
                f"{self._link.name}: no autopilot was heard in {now:.0f} s; is it running, and does it send there?"
            )

    def _give_up_without_position(self, now: float) -> None:
        """Where the vehicle is has to be known before it is called anywhere."""
        if self.autopilot.vehicle is not None or now - self._since <= self.config.patience:
            return
        frames = ", ".join(map(str, sorted(self.autopilot.other_frames)))
        have = f"positions in frame {frames} only" if frames else "no LOCAL_POSITION_NED"
        raise ResourceError(f"autopilot: have {have}, want LOCAL_NED (1); has its estimator converged?")

    def _approach(self, now: float) -> None:
        vehicle, start = self.autopilot.where(now), self._flight.setpoint(now).position
        have = "at an unknown place"
        if vehicle is not None:
            apart, speed = (float(np.linalg.norm(part)) for part in (vehicle.position - start, vehicle.velocity))
            if apart <= _CLOSE and speed <= _SLOW:
                if self._flight.is_ready():
                    self._flight.begin(now)
                    self._enter(Phase.FLYING, now)
                return
            have = f"{apart:.1f} m from the start"
        if now - self._since > self.config.patience:
            since = f"after {now - self._since:.0f} s"
            raise ResourceError(f"stream: the vehicle is {have} {since}, want {_CLOSE} m and at rest; can it go there?")

    def _refuse_far(self, vehicle: Seen, now: float) -> None:
        """A vehicle that is far off would fly there straight, whatever stands between."""
        start = self._flight.setpoint(now).position
        apart = float(np.linalg.norm(vehicle.position - start))
        if apart > self.config.farthest:
            there, here = (np.array2string(point, precision=2) for point in (start, vehicle.position))
            raise ResourceError(
                f"stream: the flight starts at {there} m and the vehicle is at {here}, {apart:.1f} m off; want at most "
                f"{self.config.farthest:g} m: fly it there, or say by --origin where its frame's origin is"
            )

    def _held(self, now: float) -> bool:
        """Whether the end was held for as long as it was to be."""
        return self.phase is Phase.HOLDING and now - self._since >= self.config.hold

    @property
    def _grace(self) -> float:
        """Seconds in which an autopilot may go into a mode that holds by itself, before the stream ends."""
        kind = self.autopilot.kind
        return _GRACE if self.config.engage and kind is not None and kind.hold is not None else 0.0

    def _notice_silence(self, now: float) -> None:
        """A silent autopilot may hear all the same: the stream goes on, for a while."""
        silence = now - self.autopilot.heard
        if self.phase is Phase.CONNECTING or self.phase in OVER:
            return
        if silence > self.config.patience:
            raise ResourceError(f"{self._link.name}: the autopilot has been silent for {silence:.0f} s")
        if (silence > _SILENT) is not self._silent:
            self._silent = not self._silent
            self._tell(now, "the autopilot is silent" if self._silent else "the autopilot is heard again")

    @property
    def _mode(self) -> str:
        return "the mode" if self.autopilot.kind is None else self.autopilot.kind.guided

    def _enter(self, phase: Phase, now: float) -> None:
        self.phase, self._since = phase, now
        self._tell(now, phase.value)


def stated(report: StreamReport) -> dict[str, float]:
    """A report in numbers: gaps [ms], and how far the vehicle was off [m]."""
    found: dict[str, float] = {"sent": report.sent, "lost": report.lost, "damaged": report.damaged}
    if len(report.gaps):
        found |= {f"gap_p{q}_ms": 1e3 * float(np.percentile(report.gaps, q)) for q in (50, 99, 100)}
    if len(report.off):
        found |= {"off_rms_m": float(np.sqrt((report.off**2).mean())), "off_max_m": float(report.off.max())}
    return found

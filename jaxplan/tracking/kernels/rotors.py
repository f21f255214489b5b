"""Rotor speeds for a commanded moment and thrust: ``tracking.rotor_commands``, compiled.

The yaw moment's equation is solved until it does not change any more, at most as often as there.
"""

import math
from typing import no_type_check

from jaxplan.tracking.kernels.compiled import inner

STEPS = 8
"""Of Newton's method, at most."""
SETTLED = 1e-9
"""N m; below, the yaw moment counts as found."""


@inner
@no_type_check
def command(craft, moment, thrust, speeds, base, commands):
    """Write the speeds [rad/s] to command for ``moment`` [N m, body] and ``thrust`` [N] at the present ``speeds``.

    ``base`` is room for four numbers.
    """
    mixer, spin = craft.mixer, craft.spin
    lowest, highest = craft.slowest * craft.slowest, craft.fastest * craft.fastest
    for i in range(4):
        base[i] = mixer[i, 0] * moment[0] + mixer[i, 1] * moment[1]
    given = _nearest_thrust(craft, base, thrust, lowest, highest)
    low, high, present = -math.inf, math.inf, 0.0
    for i in range(4):
        base[i] += mixer[i, 3] * given
        turn = craft.turns[i]
        if turn != 0.0:
            one, other = (lowest - base[i]) / turn, (highest - base[i]) / turn
            low, high = max(low, min(one, other)), min(high, max(one, other))
        present += spin[i] * speeds[i] * speeds[i]
    z = min(max(craft.torque_coefficient * present, low), high)
    for _ in range(STEPS):
        value, slope = z - moment[2], 1.0
        for i in range(4):
            yaw = mixer[i, 2]
            speed = math.sqrt(max(base[i] + yaw * z, 0.0))
            value += craft.reaction * spin[i] * (speed - speeds[i])
            slope += craft.reaction * 0.5 * spin[i] * yaw / max(speed, 1.0)
        before, z = z, min(max(z - value / slope, low), high)
        if abs(z - before) < SETTLED:
            break
    for i in range(4):
        commands[i] = math.sqrt(min(max(base[i] + mixer[i, 2] * z, lowest), highest))


@inner
@no_type_check
def _nearest_thrust(craft, tilt, wanted, lowest, highest):
    """The thrust [N] nearest to ``wanted`` that some yaw moment makes feasible; pairs of opposite yaw come last."""
    lifts = craft.mixer[0, 3] + craft.mixer[1, 3] + craft.mixer[2, 3] + craft.mixer[3, 3]
    row = 0
    for opposite in range(2):
        low, high = lowest * 4.0 / lifts, highest * 4.0 / lifts
        while row < len(craft.pairs) and craft.pairs[row, 0] == opposite:
            pair = craft.pairs[row]
            offset = pair[3] * tilt[int(pair[1])] + pair[4] * tilt[int(pair[2])]
            one, other = (pair[5] - offset) / pair[7], (pair[6] - offset) / pair[7]
            low, high = max(low, min(one, other)), min(high, max(one, other))
            row += 1
        middle = 0.5 * (low + high)
        wanted = min(max(wanted, middle if low > high else low), middle if low > high else high)
    return wanted

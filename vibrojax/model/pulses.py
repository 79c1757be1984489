"""Shock pulses as they are specified for tests: half sine, terminal-peak sawtooth, trapezoid.

Source: IEC 60068-2-27:2008, sec. 4.1.
"""

import numpy as np

from vibrojax._tools.checks import check_count, check_not_negative, check_positive, check_range
from vibrojax._tools.signatures import validated
from vibrojax.model.signals import Sampled

DROP = 1e-9
"""Time in which a sawtooth falls, over its duration."""


def _check(amplitude: float | int, duration: float | int, samples: int) -> None:
    check_range("amplitude", amplitude, allowed="a finite number (m/s2 or N)")
    check_positive("duration", duration, "s")
    check_count("samples", samples, least=4)


@validated
def half_sine(amplitude: float | int, duration: float | int, *, samples: int = 1000) -> Sampled:
    """Return the pulse amplitude sin(pi t / duration), 0 afterwards.

        simulate(rig, waveform=vj.model.half_sine(150.0, 11e-3), duration=0.5)

    Parameters:
        amplitude: largest value, m/s2 of a base or N of a force.
        duration: s.
        samples: intervals between which it is straight; it is off by at most (pi / samples)^2 / 8
            of the amplitude, 1.2e-6 by default.

    Raises `ValueError` for an amplitude that is not finite, a duration that is not above 0, or
    fewer than 4 samples.
    """
    _check(amplitude, duration, samples)
    share = np.linspace(0.0, 1.0, samples + 1)
    values = amplitude * np.sin(np.pi * share)
    values[-1] = 0.0
    return Sampled(duration * share, values)


@validated
def sawtooth(amplitude: float | int, duration: float | int, *, samples: int = 200) -> Sampled:
    """Return the terminal-peak sawtooth: it rises straight to the amplitude and drops to 0.

    The drop takes 1e-9 of the duration.

    Parameters:
        amplitude: largest value, m/s2 of a base or N of a force.
        duration: s.
        samples: intervals at which a simulation gives its motion.

    Raises `ValueError` as `half_sine` does.
    """
    _check(amplitude, duration, samples)
    share = np.linspace(0.0, 1.0, samples + 1)
    time = duration * np.append(share, 1.0 + DROP)
    return Sampled(time, amplitude * np.append(share, 0.0))


@validated
def trapezoid(
    amplitude: float | int,
    duration: float | int,
    rise: float | int,
    fall: float | int,
    *,
    samples: int = 200,
) -> Sampled:
    """Return the trapezoidal pulse: a straight rise, the amplitude held, a straight fall to 0.

    Parameters:
        amplitude: largest value, m/s2 of a base or N of a force.
        duration: of all of it, s.
        rise: duration of the rise, s.
        fall: duration of the fall, s.
        samples: intervals at which a simulation gives its motion, about.

    Raises `ValueError` as `half_sine` does, for a negative rise or fall, or for both together
    longer than the duration.
    """
    _check(amplitude, duration, samples)
    for name, part in (("rise", rise), ("fall", fall)):
        check_not_negative(name, part, "s")
    if rise + fall > duration * (1 + 1e-12):
        raise ValueError(
            f"rise and fall must be at most the duration together, {duration:g} s, got "
            f"{rise:g} s and {fall:g} s."
        )
    rise, fall = max(rise, DROP * duration), max(fall, DROP * duration)
    corners = [0.0, rise, max(duration - fall, rise * (1 + DROP)), duration]
    time = np.union1d(np.linspace(0.0, duration, samples + 1), corners)
    return Sampled(time, np.interp(time, corners, [0.0, amplitude, amplitude, 0.0]))

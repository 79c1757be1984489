"""The impact oscillator of the reference, whose regimes are known."""

import vibrojax as vj


def oscillator(gap=1.0, damping=0.1, force=0.3):
    """x'' + damping x' + x + 50 max(x - gap, 0) = force cos(w t)."""
    return vj.MatrixSystem(
        [[1.0]],
        [[damping]],
        [[1.0]],
        stops=vj.Stop(None, gap, vj.KelvinVoigt(50.0)),
        stop_map=[[1.0]],
        drive=vj.PointForce(force),
        input_map=[1.0],
        response_map=[1.0],
        proportional=True,
    )

"""The picture of the explorer: axes are drawn once, and only the lines again and again.

A whole matplotlib figure takes longer than the curve in it, so the empty axes are kept as pixels.
Limits grow when something leaves them and never shrink: what moves is the curve.
"""

import functools
import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image

from vibrojax.explorer.live_curve import LiveCurve, LiveOrbit, orbit_at
from vibrojax.explorer.swept_curve import swept_curve
from vibrojax.measured.curve import DIRECTIONS, MeasuredCurve
from vibrojax.plot.style import COLORS, DASHES, GREY, MARKERS, SMALL, balanced, dress, name_axes

SIZE, DPI = (11.0, 5.2), 100
"""Of a picture that is drawn again and again: more dots would take longer."""
SHADES = 24
"""Of a colour, down to white: more would look white."""
PLACES = 25
"""Frequencies at which a sweep has its marker."""
BRANCH, ORBIT = COLORS["black"], COLORS["violet"]


PORTRAITS = {
    "V": ("Voltage (V)", "Rate (V/s)", 1.0),
    "W^0.5": ("Root of power (W^0.5)", "Rate (W^0.5/s)", 1.0),
}
"""Axes of the portrait and the factor of the first, by the unit reported; else of motions."""


class LivePicture:
    """A figure whose lines move. Pixels of the empty axes are kept between two drawings.

    `x` is the range of the frequency, `rows` are those of the key, `unit` is that of what is
    reported.
    """

    def __init__(
        self, x: tuple[float, float], x_label: str, y_label: str, rows: int = 1, unit: str = "m"
    ):
        self._rows, y_label = rows, balanced(y_label)
        self.figure = Figure(figsize=SIZE, dpi=DPI)
        self.canvas = FigureCanvasAgg(self.figure)
        left, top = 0.065 + 0.02 * y_label.count("\n"), 0.95 - 0.05 * rows
        grid = self.figure.add_gridspec(
            2, 2, width_ratios=(1.7, 1), left=left, right=0.985, bottom=0.14, top=top, hspace=0.45
        )
        self.response = self.figure.add_subplot(grid[:, 0])
        self.portrait = self.figure.add_subplot(grid[0, 1])
        self.force = self.figure.add_subplot(grid[1, 1])
        motion = "Displacement (mm)", "Velocity (m/s)", 1e3
        along, rate, self._factor = PORTRAITS.get(unit, motion)
        labels = (
            (self.response, x_label, y_label),
            (self.portrait, along, rate),
            (self.force, "Time (drive periods)", "Contact force (N)"),
        )
        for axes, below, beside in labels:
            dress(axes)
            name_axes(axes, below, beside)
        self.response.set(xlim=x, ylim=(0.0, 1e-9))
        self.force.set(xlim=(0.0, 1.0), ylim=(0.0, 1e-9))
        self.portrait.set(xlim=(-1e-9, 1e-9), ylim=(-1e-9, 1e-9))
        self.portrait.xaxis.set_major_locator(MaxNLocator(6))
        self.portrait.set_title("thick: in contact", fontsize=SMALL, loc="right", color=GREY)
        self.lines = self._lines()
        self.background: Any = None
        self.points = np.zeros((0, 2))
        """Pixels of the points of the curve, from the left and the bottom."""

    def _lines(self) -> dict[str, Line2D]:
        lines: dict[str, Line2D] = {}

        def line(name: str, axes: Axes, color: str, **style: Any) -> None:
            (lines[name],) = axes.plot([], [], color=color, animated=True, **style)

        left = self.response
        line("stable", left, BRANCH, linewidth=1.8)
        line("unstable", left, BRANCH, linewidth=1.4, linestyle=DASHES)
        for way, face, dashes in (
            ("forward", COLORS["forward"], "-"),
            ("backward", "white", (0, (1.2, 1.2))),
        ):
            marker = {"marker": MARKERS[way], "markerfacecolor": face, "markersize": 6}
            line(way, left, COLORS[way], linestyle="none", **marker)
            line(f"{way} jumps", left, COLORS[way], linewidth=1.6, linestyle=dashes)
        ring = {"marker": "o", "markersize": 11, "markerfacecolor": "none", "markeredgewidth": 2.2}
        line("orbit", left, ORBIT, linestyle="none", **ring)
        line("portrait", self.portrait, ORBIT, linewidth=1.4)
        line("force", self.force, ORBIT, linewidth=1.4)
        line("contact", self.portrait, ORBIT, linewidth=4.0)
        return lines

    def lay_measured(self, measured: MeasuredCurve, force: bool) -> None:
        """Lay the points of a measurement, its contact forces or amplitudes, under the curve."""
        values = np.asarray(measured.contact_force if force else measured.amplitude)
        for way, name in DIRECTIONS.items():
            at = measured.direction == way
            if at.any():
                self.response.plot(
                    measured.frequency[at],
                    values[at],
                    marker={1: "^", -1: "v", 0: "s"}[way],
                    markersize=8,
                    color=GREY,
                    markerfacecolor=COLORS["light"],
                    linestyle="none",
                    zorder=1,
                    label=f"measured, {name}",
                )
        self._grow(self.response, y=(0.0, 1.05 * float(np.max(values))))

    def legend(self) -> None:
        """Name the lines, above the response."""
        names = {"stable": "stable", "unstable": "unstable", "orbit": "orbit at the right"}
        names |= {"forward": "forward sweep", "backward": "backward sweep"}
        own, own_words = self.response.get_legend_handles_labels()
        handles = [*(self.lines[name] for name in names), *own]
        words = [*names.values(), *own_words]
        self.figure.legend(
            handles,
            words,
            loc="upper left",
            bbox_to_anchor=(0.05, 1.0),
            ncols=-(-len(words) // self._rows),
            fontsize=SMALL,
            frameon=False,
            columnspacing=1.2,
            handletextpad=0.5,
        )

    def make_room(self, curve: LiveCurve) -> None:
        """Let the axes hold a curve and the orbit of its highest point."""
        if len(curve.frequency):
            self._hold(curve)
            self._hold_orbit(orbit_at(curve, int(np.argmax(curve.response))))

    def _hold(self, curve: LiveCurve) -> None:
        self._grow(self.response, y=(0.0, 1.02 * float(np.nanmax(curve.response))))

    def _hold_orbit(self, orbit: LiveOrbit) -> None:
        x, y, force = (
            self._factor * orbit.displacement,
            orbit.velocity,
            orbit.contact_force.sum(axis=0),
        )
        self._grow(self.portrait, (x.min(), x.max()), (y.min(), y.max()))
        self._grow(self.force, y=(min(0.0, force.min()), force.max()))

    def _grow(self, axes: Axes, x: tuple | None = None, y: tuple | None = None) -> None:
        """Make room for what has to be shown."""
        for wanted, get, put in (
            (x, axes.get_xlim, axes.set_xlim),
            (y, axes.get_ylim, axes.set_ylim),
        ):
            low, high = get()
            below, above = wanted or (low, high)
            if below < low or above > high:
                put(1.1 * below if below < low else low, 1.1 * above if above > high else high)
                self.background = None

    def show_curve(self, curve: LiveCurve) -> None:
        """Take the data of a curve."""
        x, y = curve.frequency, curve.response
        stable = curve.stable
        # The unstable part reaches to the first stable points beside it.
        beside = ~stable
        beside[1:] |= ~stable[:-1]
        beside[:-1] |= ~stable[1:]
        self.lines["stable"].set_data(x, np.where(stable, y, np.nan))
        self.lines["unstable"].set_data(x, np.where(beside, y, np.nan))
        places = np.linspace(*self.response.get_xlim(), PLACES)
        for way, name in ((1, "forward"), (-1, "backward")):
            sweep = swept_curve(curve, way)
            # Markers of the two directions stand side by side.
            off = 0.25 * way * (places[1] - places[0])
            self.lines[name].set_data(*sweep.places(places[1:-1] + off).T)
            broken = np.full((len(sweep.jumps), 3, 2), np.nan)  # a gap after each jump
            broken[:, :2] = np.reshape(sweep.jumps, (-1, 2, 2))
            self.lines[f"{name} jumps"].set_data(*broken.reshape(-1, 2).T)
        if len(y):
            self._hold(curve)
        self.points = self.response.transData.transform(np.stack([x, y], axis=1))

    def show_orbit(self, curve: LiveCurve, at: int | None) -> None:
        """Take the data of the orbit of a point of the curve; of none without a point."""
        if at is None:
            for name in ("orbit", "portrait", "contact", "force"):
                self.lines[name].set_data([], [])
            return
        orbit = orbit_at(curve, at)
        x, y = self._factor * orbit.displacement, orbit.velocity
        self.lines["orbit"].set_data([curve.frequency[at]], [curve.response[at]])
        self.lines["portrait"].set_data(x, y)
        self.lines["contact"].set_data(x, np.where(orbit.touching, y, np.nan))
        self.lines["force"].set_data(orbit.phase, orbit.contact_force.sum(axis=0))
        self._hold_orbit(orbit)

    def nearest(self, x: float, y: float) -> int | None:
        """Return the point of the curve nearest to a place of the picture.

        `x` and `y` are shares of its width from the left and of its height from the top; None
        outside the panel of the response.
        """
        width, height = self.canvas.get_width_height()
        place = np.array([x * width, (1 - y) * height])
        if not len(self.points) or not self.response.bbox.contains(*place):
            return None
        return self._nearest(place)

    def nearest_to(self, frequency: float, response: float) -> int:
        """Return the point of the curve that is drawn nearest to these data."""
        return self._nearest(self.response.transData.transform((frequency, response)))

    def _nearest(self, place: np.ndarray) -> int:
        return int(np.nanargmin(np.hypot(*(self.points - place).T)))

    def freeze(self, title: str) -> None:
        """Make it a still picture, with the numbers it was drawn for as its title."""
        for line in self.lines.values():
            line.set_animated(False)
        self.response.set_title(title, fontsize=SMALL, loc="right", color=GREY)
        self.background = None

    def note(self, words: str) -> None:
        """Write a sentence along the lower edge."""
        self.figure.text(0.99, 0.008, words, fontsize=SMALL - 1, color=GREY, ha="right")
        self.background = None

    def png(self) -> bytes:
        """Draw, and return the picture as PNG."""
        if self.background is None:
            self.canvas.draw()
            self.background = self.canvas.copy_from_bbox(self.figure.bbox)
        self.canvas.restore_region(self.background)
        for line in self.lines.values():
            assert line.axes is not None
            line.axes.draw_artist(line)
        pixels = Image.fromarray(np.asarray(self.canvas.buffer_rgba()))
        stream = io.BytesIO()
        # With a palette it is coded in a sixth of the time.
        few = pixels.convert("RGB").quantize(palette=_palette(), dither=Image.Dither.NONE)
        few.save(stream, format="png", compress_level=1)
        return stream.getvalue()


@functools.cache
def _palette() -> Image.Image:
    """Return the colours of all lines, each from its own down to white."""
    names = (BRANCH, GREY, ORBIT, COLORS["forward"], COLORS["backward"])
    shades = [
        1 + share * (np.asarray(to_rgb(name)) - 1)
        for name in names
        for share in np.linspace(0.0, 1.0, SHADES)
    ]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255 * np.concatenate(shades)).astype(int).tolist())
    return palette

"""The pair of beams of Woiwode and Krack 2024: beams in sections, one with a mini-beam as its stop.

Numbers are in `rig.csv`, their sources in README.md. Places are in m from the clamp, those of the
mini-beam from its root.
"""

import csv
import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import sparse

import vibrojax as vj

HERE = Path(__file__).parent


def read_numbers() -> dict[str, float]:
    """The numbers of the rig by quantity, SI; ranges of figures are left out."""
    with open(HERE / "rig.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if " to " not in row["value"]]
    return {row["quantity"]: float(row["value"]) for row in rows}


NUMBERS = read_numbers()
MEASURED = {
    side: [v for n, v in NUMBERS.items() if n.startswith("measured") and ("left" in n) is left]
    for side, left in (("left", True), ("right", False))
}
"""Natural frequencies without contact, Hz, lowest first; those of the mini-beam with the right."""
LENGTH, HEIGHT, WIDTH = (
    NUMBERS[name] for name in ("length of both beams", "height in bending", "width")
)
MODULUS, DENSITY, GAP = (NUMBERS[name] for name in ("Young's modulus", "density", "gap"))
PER_LENGTH = DENSITY * WIDTH * HEIGHT
"""Mass of a bare beam, kg/m."""
BOLTED = LENGTH - 102.5e-3, LENGTH - 62.5e-3
"""Ends of what is bolted on: the tuning plate on the left, the clamp of the mini-beam on the right.
The mini-beam begins at the second one."""
PLATE_WIDTH = 40e-3
"""Of what is bolted on, and of the mini-beam, m."""
CAP_NUT = LENGTH - 11.5e-3
"""Where the left beam touches."""
MINI_LENGTH, MINI_HEIGHT = NUMBERS["mini-beam free length"], 1e-3
TOUCHED = MINI_LENGTH - 6e-3
"""Where the mini-beam is touched."""
SENSOR = LENGTH - 12e-3
"""Point 11 of the scanning vibrometer, on the right beam."""
LONGEST = 5e-3
"""Longest element, m: half of it changes no natural frequency by more than 3e-7."""


class Factors(NamedTuple):
    """Factors on bending stiffnesses, by which a model of beams meets what was measured."""

    left: float = 1.0
    plate: float = 1.0
    """Of the section with the tuning plate."""
    right: float = 1.0
    clamp: float = 1.0
    """Of the section with the clamp of the mini-beam."""
    mini: float = 1.0


DRAWN = Factors()
"""Bolted sections as stiff as if they were one piece."""
SOURCE = Factors(left=1.0, plate=0.75, right=1.08, clamp=0.1, mini=1.07)
"""Of the source, which found them by trial."""


class Section(NamedTuple):
    """A stretch of a beam."""

    start: float
    end: float
    rigidity: float
    """E I, N m2."""
    mass: float
    """kg/m."""


class Body(NamedTuple):
    """A beam as finite elements."""

    elements: vj.model.FiniteElements
    touch: int
    """Node at which it meets the other beam."""
    sensor: int

    def reduced(self, highest_frequency: float = 1200.0) -> vj.model.Reduction:
        """Its natural modes, and the static shape by a force where it is touched."""
        return vj.model.reduce(
            self.elements,
            method="modal",
            highest_frequency=highest_frequency,
            stop_map=[self.elements.row(node=self.touch, dof=3)],
            response_map=self.elements.row(node=self.sensor, dof=3),
            input_map=self.elements.base_load(dof=3),
        )

    def frequencies(self, count: int) -> np.ndarray:
        """Natural frequencies, Hz."""
        return self.reduced().angular_frequency[:count] / (2 * np.pi)


class Mesh:
    """Beam elements (Euler and Bernoulli, cubic shapes), collected beam by beam."""

    def __init__(self) -> None:
        self.nodes = 0
        self.parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, sections: list[Section], place: float, root: int | None = None) -> list[int]:
        """Add a beam, its first node that at `root` of another one; nodes at `place` and the ends.

        The beam has a node at each end of a section too; returned are those at `place`, at the end
        of its second section or of the only one, and at its tip.
        """
        keys = sorted({sections[0].start, place, *(s.end for s in sections)})
        x = np.array(keys[:1])
        for before, after in itertools.pairwise(keys):
            count = int(np.ceil((after - before) / LONGEST - 1e-9))
            x = np.append(x, np.linspace(before, after, count + 1)[1:])
        known = 0 if root is None else 1
        nodes = np.arange(self.nodes + 1 - known, self.nodes + 1 - known + len(x))
        self.nodes += len(x) - known
        if root is not None:
            nodes[0] = root
        for k, length in enumerate(np.diff(x)):
            section = next(s for s in sections if s.start < x[k] + length / 2 < s.end)
            self.parts.append((nodes[k : k + 2], *element(section, length)))
        wanted = place, sections[min(1, len(sections) - 1)].end, sections[-1].end
        return [int(nodes[np.argmin(np.abs(x - w))]) for w in wanted]

    def add_mass(self, node: int, mass: float) -> None:
        """Add a mass without rotary inertia."""
        self.parts.append((np.array([node]), np.zeros((2, 2)), np.diag([mass, 0.0])))

    def elements(self) -> vj.model.FiniteElements:
        """The matrices, node 1 held."""
        shape = (2 * self.nodes, 2 * self.nodes)
        stiffness, mass = sparse.lil_array(shape), sparse.lil_array(shape)
        for nodes, bending, inertia in self.parts:
            at = (2 * (nodes[:, None] - 1) + [0, 1]).ravel()
            stiffness[np.ix_(at, at)] += bending
            mass[np.ix_(at, at)] += inertia
        numbers = np.repeat(np.arange(1, self.nodes + 1), 2)
        labels = np.stack([numbers, np.tile([3, 5], self.nodes)], axis=1)
        loose = vj.model.FiniteElements(
            mass=mass.tocsc(), stiffness=stiffness.tocsc(), degrees_of_freedom=labels
        )
        return loose.held(nodes=[1])


def element(section: Section, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and consistent mass of an element of length h: deflection, rotation, both ends."""
    bending = [
        [12, 6 * h, -12, 6 * h],
        [6 * h, 4 * h**2, -6 * h, 2 * h**2],
        [-12, -6 * h, 12, -6 * h],
        [6 * h, 2 * h**2, -6 * h, 4 * h**2],
    ]
    inertia = [
        [156, 22 * h, 54, -13 * h],
        [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54, 13 * h, 156, -22 * h],
        [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ]
    return section.rigidity / h**3 * np.array(bending), section.mass * h / 420 * np.array(inertia)


def rigidity(height: float, width: float = WIDTH) -> float:
    """E I of a rectangle, N m2."""
    return MODULUS * width * height**3 / 12


def with_plate(mass: float, height: float, whole: float, bolted: float) -> list[Section]:
    """A beam with a mass bolted on over 40 mm, its height spread over the width of the beam."""
    thick = HEIGHT + height * PLATE_WIDTH / WIDTH
    bare = whole * rigidity(HEIGHT), PER_LENGTH
    plate = whole * bolted * rigidity(thick), PER_LENGTH + mass / (BOLTED[1] - BOLTED[0])
    return [
        Section(0.0, BOLTED[0], *bare),
        Section(*BOLTED, *plate),
        Section(BOLTED[1], LENGTH, *bare),
    ]


def left_beam(factors: Factors = SOURCE) -> Body:
    """The beam with the tuning plate and the cap nut."""
    mesh = Mesh()
    beam = with_plate(NUMBERS["tuning plate mass"], 1e-3, factors.left, factors.plate)
    cap_nut, _, _ = mesh.add(beam, CAP_NUT)
    mesh.add_mass(cap_nut, NUMBERS["tip mass of left beam"])
    return Body(mesh.elements(), cap_nut, cap_nut)


def right_beam(factors: Factors = SOURCE, mini_width: float = PLATE_WIDTH) -> Body:
    """The beam that carries the mini-beam, the soft stop between the two.

    `mini_width` scales stiffness and mass of the mini-beam together; the code of the source has the
    width of the large beams there.
    """
    mesh = Mesh()
    mass = NUMBERS["mini-beam clamping mass on right beam"]
    sensor, root, _ = mesh.add(with_plate(mass, 13.5e-3, factors.right, factors.clamp), SENSOR)
    per_length = NUMBERS["mini-beam mass (free part)"] / MINI_LENGTH * mini_width / PLATE_WIDTH
    stiffness = factors.mini * rigidity(MINI_HEIGHT, mini_width)
    mini = [Section(0.0, MINI_LENGTH, stiffness, per_length)]
    touched, _, _ = mesh.add(mini, TOUCHED, root)
    return Body(mesh.elements(), touched, sensor)


def point_masses_on_cantilevers() -> tuple[vj.Cantilever, vj.Cantilever]:
    """Both beams as uniform cantilevers that carry their masses at points, left and right."""
    middle, mini = sum(BOLTED) / 2, BOLTED[1] + MINI_LENGTH / 2
    left = {middle: "tuning plate mass", CAP_NUT: "tip mass of left beam"}
    right = {
        middle: "mini-beam clamping mass on right beam",
        mini: "mini-beam mass (free part)",
    }

    def beam(masses: dict[float, str]) -> vj.Cantilever:
        points = [vj.PointMass(NUMBERS[name], x / LENGTH) for x, name in masses.items()]
        return vj.Cantilever(LENGTH, WIDTH, HEIGHT, MODULUS, DENSITY, point_masses=points)

    return beam(left), beam(right)


def pair(
    *,
    contact_stiffness: float = 1e5,
    contact_damping: float = 5.0,
    damping_ratio: float = 2e-3,
    gap: float = GAP,
    base_acceleration: float = 0.0305,
    factors: Factors = SOURCE,
) -> vj.Joined:
    """Both beams, which meet at the mini-beam; what is reported is of the right one, at point 11.

    The stop between them is what deforms at the touch itself, six times as stiff as the mini-beam
    there. Its numbers and the damping ratio of all modes are assumed. The base moves as much at any
    frequency as `base_acceleration` (m/s2) is at the first natural frequency of the right beam.
    """
    right, left = right_beam(factors).reduced(350.0), left_beam(factors).reduced(350.0)
    first = float(right.angular_frequency[0])
    bodies = [
        vj.MatrixSystem(
            mass=np.eye(len(body.angular_frequency)),
            damping=2 * damping_ratio * np.diag(body.angular_frequency),
            stiffness=np.diag(body.angular_frequency**2),
            response_map=body.response_map,
            input_map=body.input_map,
            drive=drive,
        )
        for body, drive in ((right, vj.BaseMotion(base_acceleration / first**2)), (left, None))
    ]
    stop = vj.Stop(None, gap, vj.KelvinVoigt(contact_stiffness, contact_damping))
    return vj.Joined(*bodies, stop, first_map=right.stop_map, second_map=left.stop_map)

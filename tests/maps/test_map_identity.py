"""What belongs to the identity of a map: all rigs, and all that its functions read."""

import sys
import time
from types import ModuleType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
import zarr
from map_program import oscillator

import vibrojax as vj
from vibrojax.ensemble.arguments import arguments_of
from vibrojax.maps.chunks import cut
from vibrojax.maps.fingerprints import identity_of, value_digest
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.work import MapWork

NATURAL = np.linspace(1.0, 2.0, 8)
GAPS = np.full(8, 3e-3)
FACTOR = 1.0
TABLE = np.arange(20.0)
settings = ModuleType("settings_of_the_user")
settings.FACTOR = 1.0


@pytest.fixture
def computed(monkeypatch):
    """Numbers of the chunks that were computed."""
    numbers = []
    compute = MapWork.compute

    def noted(self, number):
        numbers.append(number)
        return compute(self, number)

    monkeypatch.setattr(MapWork, "compute", noted)
    return numbers


def traced(gaps):
    """A function of the rig with a table of gaps, which JAX can trace."""
    return lambda natural: oscillator(natural, jnp.interp(natural, NATURAL, jnp.asarray(gaps)))


def called(gaps):
    """The same as a dictionary, which is called for every lane."""
    table = {float(n): float(gap) for n, gap in zip(NATURAL, gaps, strict=True)}
    return lambda natural: oscillator(natural, table[float(natural)])


def small_map(rig, store, **more):
    few = {"measures": ["natural_frequency"], "keep_curves": True, "chunk_lanes": 2}
    return vj.parameter_map(
        rig, natural=NATURAL, frequency_ratio=[0.9, 1.0, 1.1], store=store, progress=False,
        response=vj.SweepSettings("forward", refine_jumps=None), **(few | more),
    )  # fmt: skip


# --------------------------------------------------------------------------------------- rigs


@pytest.mark.parametrize("kind", [traced, pytest.param(called, marks=pytest.mark.slow)])
@pytest.mark.parametrize("lanes", [(3,), (2, 5), (0,), (7,)])
def test_chunks_of_corrected_lanes_and_only_they_are_computed_again(
    tmp_path, computed, kind, lanes
):
    store, corrected = tmp_path / "map", GAPS.copy()
    small_map(kind(GAPS), store)
    corrected[list(lanes)] = 1e-3
    changed = sorted({lane // 2 for lane in lanes})
    computed.clear()
    small_map(kind(GAPS), store)
    assert computed == []
    message = rf"other rigs.*chunk {changed[0]} at natural.*These {len(changed)} of 4 chunks are"
    with pytest.warns(UserWarning, match=message):
        found = small_map(kind(corrected), store)
    assert computed == changed
    fresh = small_map(kind(corrected), tmp_path / "fresh")
    for name in fresh.variables:
        np.testing.assert_array_equal(found[name], fresh[name])
    assert found.attrs["vibrojax_map"] == fresh.attrs["vibrojax_map"]
    computed.clear()
    small_map(kind(corrected), store)  # without a word
    assert computed == []


def test_rigs_that_are_all_others_are_refused(tmp_path):
    small_map(traced(GAPS), tmp_path / "map")
    with pytest.raises(ValueError, match=r"other settings\. first rig: .* there, .* now"):
        small_map(traced(np.full(8, 1e-3)), tmp_path / "map")


def test_an_interrupted_correction_goes_on(tmp_path, computed, monkeypatch):
    store, corrected = tmp_path / "map", GAPS.copy()
    small_map(traced(GAPS), store)
    corrected[2:6] = 1e-3
    compute = MapWork.compute

    def interrupted(self, number):
        if number == 2:
            raise KeyboardInterrupt
        return compute(self, number)

    with monkeypatch.context() as patched:
        patched.setattr(MapWork, "compute", interrupted)
        with pytest.warns(UserWarning, match="other rigs"), pytest.raises(KeyboardInterrupt):
            small_map(traced(corrected), store)
    computed.clear()
    small_map(traced(corrected), store)  # no damage: it is known what is missing
    assert computed == [2]


def test_digests_of_rigs_are_those_of_every_lane_alone_and_together():
    def rig(natural, gap):
        return oscillator(natural * jnp.exp(natural), gap / 3.0)

    maker = RigMaker(
        rig, arguments_of(rig, (), {"natural": np.linspace(1, 2, 50), "gap": [1e-3, 2e-3]})
    )
    chunks = cut((50, 2), (False, False), 7)
    blocks = [chunks.at(k) for k in range(chunks.number)]
    together = list(maker.digests(blocks))
    assert len(set(together)) == len(blocks)
    assert [next(iter(maker.digests([block]))) for block in blocks] == together
    assert list(maker.digests(blocks[::-1])) == together[::-1]


def test_texts_and_numbers_that_decide_the_structure_have_digests_too():
    def rig(formulation, num_modes, gap):
        return vj.default_rig(formulation=formulation, num_modes=num_modes, gap=gap)

    axes = {"formulation": ["consistent", "as_printed"], "num_modes": [1, 2], "gap": [1e-3, 2e-3]}
    for more in (axes, {"formulation": axes["formulation"], "num_modes": [1, 2]}):
        fixed = {} if "gap" in more else {"gap": 1e-3}
        maker = RigMaker(rig, arguments_of(rig, (), more | fixed))
        chunks = cut(maker.arguments.shape, maker.static, 100)
        digests = list(maker.digests(chunks.at(k) for k in range(chunks.number)))
        assert len(set(digests)) == chunks.number == 4


@pytest.mark.slow
def test_a_million_rigs_are_compared_in_seconds():
    maker = RigMaker(
        oscillator,
        arguments_of(
            oscillator, (), {"natural": np.linspace(1, 2, 1000), "gap": np.linspace(1, 2, 1000)}
        ),
    )
    chunks = cut((1000, 1000), (False, False), 1000)
    began = time.process_time()
    assert len(set(maker.digests(map(chunks.at, range(chunks.number))))) == 1000
    assert time.process_time() - began < 30  # 4 s where nothing else runs


# ------------------------------------------------------------------------------------ measures


def scaled(curve):
    return FACTOR * curve["amplitude_ratio"].max()


def looked_up(curve):
    return TABLE[3] * curve["amplitude_ratio"].max()


def of_a_module(curve):
    return settings.FACTOR * curve["amplitude_ratio"].max()


def imported(curve):
    from settings_of_the_user import FACTOR as factor

    return factor * curve["amplitude_ratio"].max()


def helped(curve):
    return scaled(curve)


@jax.jit
def compiled(curve):
    return FACTOR * curve["amplitude_ratio"].max()


class Scaled:
    """A measure with a number of its own."""

    def __init__(self, factor):
        self.factor, self.calls = factor, 0

    def __call__(self, curve):
        self.calls += 1
        return self.factor * curve["amplitude_ratio"].max()


def change_global(monkeypatch):
    monkeypatch.setitem(globals(), "FACTOR", 2.0)


def change_table(monkeypatch):
    monkeypatch.setitem(globals(), "TABLE", np.where(np.arange(20) == 3, 7.0, TABLE))


def change_module(monkeypatch):
    monkeypatch.setattr(settings, "FACTOR", 2.0)


@pytest.mark.parametrize(
    ("measure", "change", "sentence"),
    [
        (scaled, change_global, "measures: scaled: reads: FACTOR: '1.0' there, '2.0' now"),
        (looked_up, change_table, "measures: looked_up: reads: TABLE: "),
        (of_a_module, change_module, "reads: settings.FACTOR: '1.0' there, '2.0' now"),
        (imported, change_module, "reads: settings_of_the_user.FACTOR: '1.0' there, '2.0' now"),
        (helped, change_global, "measures: helped: reads: scaled: .*FACTOR = 1.0.*FACTOR = 2.0"),
        (compiled, change_global, "measures: compiled: reads: function: .*1.0.*2.0"),
    ],
)
def test_a_measure_that_reads_something_else_now_is_refused(
    tmp_path, monkeypatch, measure, change, sentence
):
    monkeypatch.setitem(sys.modules, "settings_of_the_user", settings)
    store = tmp_path / "map"
    small_map(traced(GAPS), store, measures=measure, keep_curves=False)
    small_map(traced(GAPS), store, measures=measure, keep_curves=False)
    change(monkeypatch)
    with pytest.raises(ValueError, match=sentence):
        small_map(traced(GAPS), store, measures=measure, keep_curves=False)


def test_a_measure_with_state_is_known_by_what_is_no_counter(tmp_path):
    def call(factor):
        return small_map(
            traced(GAPS), tmp_path / "map", measures={"scaled": Scaled(factor)}, keep_curves=False
        )

    first = call(1.0)
    assert "calls': 'changes while" in str(first.attrs["vibrojax_map"]).replace('"', "'")
    xarray.testing.assert_identical(first, call(1.0))
    # Also where somebody wrote into it, and something is left to compute.
    zarr.open_group(str(tmp_path / "map")).attrs["author"] = "me"
    (tmp_path / "map" / "scaled" / "c" / "1").unlink()
    with pytest.warns(UserWarning, match=r"damaged: chunk 1 at .*: scaled .missing"):
        again = call(1.0)
    xarray.testing.assert_identical(again, first.assign_attrs(author="me"))
    call(1.0)
    with pytest.raises(
        ValueError, match=r"measures: scaled: reads: factor: '1.0' there, '2.0' now"
    ):
        call(2.0)


def test_what_cannot_be_read_is_said(tmp_path):
    file = (tmp_path / "table").open("w+")

    def of_a_file(curve):
        return float(file.read() or 1.0)

    message = r"of_a_file: file \(a TextIOWrapper\) cannot be read. When it changes"
    with pytest.warns(UserWarning, match=message):
        small_map(traced(GAPS), tmp_path / "map", measures=of_a_file, keep_curves=False)
    file.close()


def test_comments_are_no_difference():
    source = "def f(x):\n    {}return x + A\n"
    found = []
    for comment in ("", "# of nothing\n    "):
        names = {"A": 1.0}
        code = compile(source.format(comment), "<none>", "exec")
        exec(code, names)
        found.append(identity_of(names["f"]))
    assert found[0].source == found[1].source
    assert found[0].reads == {"A": "1.0"}


def test_functions_that_differ_are_distinguished():
    def make(k):
        return lambda x: x + k

    assert identity_of(make(1)).source.startswith("lambda x: x + k <code ")
    one, other = (lambda x: x + 1), (lambda x: x + 2)
    assert identity_of(one).source != identity_of(other).source
    settings = dict(
        one=lambda x: x * 2,  # beside something else
    )
    assert identity_of(settings["one"]).source.startswith("lambda x: x * 2 <code ")
    assert identity_of(make(1)) == identity_of(make(1)) != identity_of(make(2))

    def with_default(x, k=1):
        return x + k

    before = identity_of(with_default)
    with_default.__defaults__ = (2,)
    assert identity_of(with_default) != before
    for value in (
        1.0,
        "a",
        None,
        [1, 2],
        {"a": np.arange(3)},
        {1, 2},
        1 + 2j,
        b"a",
        xarray.DataArray([1.0]),
    ):
        first, again = identity_of(make(value)), identity_of(make(value))
        assert first == again
        assert first.unknown == ()
        assert first != identity_of(make([value]))
    loop = []
    loop.append(loop)
    assert identity_of(make(loop)).unknown == ()


def test_systems_are_known_by_their_numbers_and_their_code():
    one = value_digest(vj.default_rig())
    assert value_digest(vj.default_rig()) == one
    assert value_digest(vj.default_rig(gap=5e-4)) != one
    found = []
    for sign in "+-":
        names = {"eqx": eqx, "__name__": "of_the_user"}
        exec(f"class Law(eqx.Module):\n  k: float\n  def force(self, x): return {sign}x", names)
        found.append(value_digest(names["Law"](1.0)))
    assert found[0] != found[1]


def test_what_does_anything_when_it_is_looked_at_is_only_named():
    class Odd:
        def __reduce_ex__(self, _):
            raise RuntimeError("no")

    odd = Odd()
    assert identity_of(lambda x: (x, odd)).unknown == ("odd (a Odd)",)

    class Measure(Odd):
        def __call__(self, curve):
            return 1.0

    assert identity_of(Measure()).unknown == ("what this " + Measure.__qualname__ + " holds",)
    assert identity_of(lambda x: (x, jax.random.key(0))).unknown == ()
    key = jax.random.key(1)
    assert identity_of(lambda x: (x, key)).unknown == ()


def test_a_fixed_function_is_known_by_its_code(tmp_path):
    def call(law):
        def rig(natural, law):
            return oscillator(natural, law(1e-3))

        return small_map(rig, tmp_path / "map", law=law)

    call(lambda gap: gap)
    call(lambda gap: gap)
    with pytest.raises(ValueError, match=r"fixed: law: '<lambda> .*' there"):
        call(lambda gap: 2 * gap)

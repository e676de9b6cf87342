"""Sentences of docs/solver.md have the constants of the code, and the numbers of the tables beside the page."""

import math
import re

import numpy as np
import pytest

from morphofold.forecasts import richardson
from morphofold.sim import body, dynamics, nested_meshes, stage_checks, theory
from morphofold.sim.effects import contact, corner_barrier
from morphofold.sim.elements import brick_kernels, tet_kernels
from morphofold.sim.elements.bricks import Bricks
from morphofold.sim.elements.tets import Tets
from morphofold.sim.equilibrium import rest_distance, wrinkle_onset
from morphofold.sim.multilevel_acceleration import LEVEL_ACCELERATIONS
from morphofold.sim.scene import COARSE_LEVEL, CROSSINGS_PER_UNIT_GROWTH, LEVELS
from morphofold.studies.page_sentences import Page, spread

PAGE = Page("solver")
MOST_WAITED = dynamics.PATIENCE_TICKS * dynamics.MOST_PATIENCE_FACTOR


def per_cent(cell: str) -> float:
    return float(cell.removesuffix(" %"))


# constants of the code -------------------------------------------------------------------------------------------


def test_pace_and_rest_in_short():
    PAGE.assert_sentence("g rises by 1 in # ticks; a tick is", CROSSINGS_PER_UNIT_GROWTH)
    PAGE.assert_sentence("until the body is within # T of rest, or", dynamics.REST_DISTANCE_OVER_T)
    PAGE.assert_sentence("or for # ticks if it does not come so near", dynamics.PATIENCE_TICKS)


def test_elements_and_filter():
    PAGE.assert_sentence("the modulus of the pressure is `kappa_ratio` - # times mu", Bricks.LOCAL)
    PAGE.assert_sentence("patches of up to # tets of one material", tet_kernels.PATCH_TETS)
    assert tet_kernels.OWN_GRADIENT_SHARE == 0.5  # "and half of the shear energy"
    PAGE.assert_sentence("β = # for bricks, # for tets", body.FILTER_STRENGTH[4], body.FILTER_STRENGTH[3])


def test_mass_and_levels():
    PAGE.assert_sentence("every # steps each node gets a mass", dynamics.STEPS_PER_MEASUREMENT)
    cortex, core = ((least, body.LARGEST_MASS) for least in (body.LEAST_CORTEX_MASS, body.LEAST_CORE_MASS))
    PAGE.assert_sentence("# to # times the bound in the cortex, # to # times in the core", *cortex, *core)
    PAGE.assert_sentence("moves with the nodal mass over #, a zigzag", 1 + sum(LEVEL_ACCELERATIONS))


def test_split_bulk_modulus():
    assert Bricks.MODULUS_RATIO == 2  # "only half of a brick's kappa"
    share_of_damping = dynamics.FOLLOW_OVER_BOUND / (Bricks.MODULUS_RATIO - 1)
    PAGE.assert_sentence("θ is # c, at most #,", share_of_damping, dynamics.MOST_FOLLOW)
    PAGE.assert_sentence("held for more than # ticks the modulus is whole", dynamics.PATIENCE_TICKS)
    PAGE.assert_sentence("or more than # times as stiff", body.MOST_SPLIT_RATIO)
    PAGE.assert_sentence("for a kappa ratio below #, and for", body.LEAST_SPLIT_KAPPA)
    PAGE.assert_sentence("for growth beyond #.", body.MOST_SPLIT_GROWTH)


def test_clock():
    PAGE.assert_sentence("g rises by 1 in # ticks over `growth.rate`", CROSSINGS_PER_UNIT_GROWTH)
    PAGE.assert_sentence("fall by exp(#) a tick, on every mesh", -dynamics.DAMPING_PER_CROSSING)
    PAGE.assert_sentence("There, velocities fall by exp(#) a tick", -dynamics.REST_DAMPING_PER_CROSSING)


def test_rules_of_rest():
    near, least, most = dynamics.REST_DISTANCE_OVER_T, dynamics.LEAST_PATIENCE_TICKS, dynamics.PATIENCE_TICKS
    PAGE.assert_sentence("*At rest* is a body within # T (rms over the nodes)", near)
    PAGE.assert_sentence("of rest for # ticks. Beyond", dynamics.REST_TICKS)
    PAGE.assert_sentence("held for # to # ticks more, and must move by less than # T", least, most, near)
    PAGE.assert_sentence("*Patience* is # ticks; after little growth", most)
    assert dynamics.PATIENCE_PER_GROWTH_TICK == 4 / 3
    PAGE.assert_sentence("as many ticks as that took, times 4/3, at least #.", least)
    PAGE.assert_sentence("Farther than # T from rest", dynamics.AWAY_DISTANCE_OVER_T)
    PAGE.assert_sentence("growth waits for up to # ticks", MOST_WAITED)
    PAGE.assert_sentence("critically for the first # ticks", dynamics.RING_DOWN_TICKS)
    PAGE.assert_sentence("is held for another # ticks, up to # in all", most, MOST_WAITED)
    slender_ticks = dynamics.SLENDER_PATIENCE_TICKS * dynamics.MOST_PATIENCE_FACTOR
    slender_share = 100 * rest_distance.REST_SHARE_OF_DISPLACEMENT
    PAGE.assert_sentence("gets up to # ticks, and must come within # % of its", slender_ticks, slender_share)
    PAGE.assert_sentence("A healthy stage has # T at most", stage_checks.LARGEST_REST_DISTANCE_OVER_T)
    PAGE.assert_sentence("than assumed the estimate fell, # at most", rest_distance.MOST_SLOWNESS)


def test_nested_meshes():
    PAGE.assert_sentence("grows on # T, but on # T from", LEVELS[COARSE_LEVEL], LEVELS["fine"])
    assert LEVELS["fine"] == LEVELS["finest"]
    PAGE.assert_sentence("from # of the growth strain of theory's first", nested_meshes.WINDOW_START)
    PAGE.assert_sentence("to # times that of the first contact", nested_meshes.WINDOW_END)
    PAGE.assert_sentence("is held for # ticks on the coarse mesh", nested_meshes.COARSE_TICKS)
    PAGE.assert_sentence("held for # ticks there and written", nested_meshes.FINE_TICKS)
    PAGE.assert_sentence("A stage inside is held for # ticks", nested_meshes.FINE_TICKS)


def test_pace_of_growth():
    slow = wrinkle_onset.SLOW_GROWTH_BEFORE, wrinkle_onset.SLOW_GROWTH_AFTER, wrinkle_onset.SLOW_PACE
    PAGE.assert_sentence("from # before to # after theory's growth the pace is at most # over the mu ratio", *slow)
    PAGE.assert_sentence("gently, over the first #.", dynamics.SOFT_START_GROWTH)
    PAGE.assert_sentence("to # of its pace at least", dynamics.SLOWEST_PACE)
    PAGE.assert_sentence("kinetic energy exceeds # of the strain energy", dynamics.KINETIC_LIMIT, tolerance=0)
    PAGE.assert_sentence("(before g = #, of that at #)", *[1 + dynamics.EARLY_GROWTH_STRAIN] * 2)
    PAGE.assert_sentence("deeper than # cells in the gap of contact", contact.WAIT_DEPTH_IN_CELLS)
    PAGE.assert_sentence("frozen below J = #,", brick_kernels.FROZEN_BELOW_J)
    PAGE.assert_sentence("a J above # (in tets #)", Bricks.LARGEST_J, Tets.LARGEST_J)
    assert f"(one for every {dynamics.NODES_PER_THREAD:,} nodes)" in PAGE.prose


def test_contact_resolution_and_checks():
    PAGE.assert_sentence("searches within # cells", contact.SEARCH_RADIUS_IN_CELLS)
    PAGE.assert_sentence("chosen again every # steps", contact.STEPS_PER_PAIRING)
    PAGE.assert_sentence("below a gap of # cells", contact.GAP_IN_CELLS)
    strength, least_J = corner_barrier.STRENGTH, corner_barrier.LEAST_J
    PAGE.assert_sentence("½ · # μ w (# - J)² where J < #,", strength, least_J, least_J)
    over_T, over_wave = (stage_checks.BOUNDS[name][0] for name in ("cell_over_T", "cell_over_wave"))
    PAGE.assert_sentence("of the cortex over T, is # at most", over_T)
    missed = 100 * (2 * math.pi * over_wave) ** 2 / 12
    PAGE.assert_sentence("first wavelength, #, where", over_wave)
    PAGE.assert_sentence("/ 12 = # % of a wave's energy", missed, tolerance=0.5)
    PAGE.assert_sentence("edges # times as long, where folds stay", richardson.COARSER_EDGE_RATIO)
    PAGE.assert_sentence("holds them for # ticks on both", richardson.HOLD_TICKS)
    assert richardson.ORDER == 1  # "roughly in proportion to its edges"
    assert f"covered twice along {stage_checks.NUMBER_OF_RAYS:,} rays" in PAGE.prose
    PAGE.assert_sentence("A crossing deeper than # edges is not healthy", stage_checks.CROSSING_TOLERANCE)


def test_creases_and_wrinkles_of_a_block():
    crease, biot = theory.CREASE ** (1 / 3), theory.BIOT ** (1 / 3)
    PAGE.assert_sentence("$`#^{1/3}`$ = # on (Hong", theory.CREASE, crease)
    PAGE.assert_sentence("$`#^{1/3}`$ = # (Biot)", theory.BIOT, biot)
    PAGE.assert_sentence("of theory's # on edges", crease)


# results, as the tables beside the page have them --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rest", "mesh", "onset", "notches"])
def test_the_rows_of_the_page_are_rows_of_the_table_beside_it(name):
    (rows,), all_rows = PAGE.tables(name), PAGE.tsv_rows(name)
    assert rows
    assert all(sum(row.items() <= other.items() for other in all_rows) == 1 for row in rows)
    count = re.search(rf"All (\d+) \w+[^\[]*\[solver-{name}\.tsv\]", PAGE.prose)
    assert count is None or int(count[1]) == len(all_rows)


def test_levels():
    rows = PAGE.tsv_rows("levels")
    steps = {row["note"] or row["added by the levels"]: row["steps to g = 2"] for row in rows}
    without, with_levels = (float(str(steps[key]).replace(",", "")) for key in ("0, 0", "used"))
    PAGE.assert_sentence("It takes # times fewer steps", without / with_levels, tolerance=0.051)
    burst = [row for row in rows if "bursts" in str(row["note"])]
    waves = [[value for key, value in row.items() if "wave" in key and isinstance(value, float)] for row in burst]
    (limit,) = PAGE.numbers("and above # runs may burst")
    assert len(waves) == 2
    assert all(max(values) > limit for values in waves)


def test_distance_from_rest():
    reported, newton, _ = PAGE.tsv_rows("rest-distance")
    ratios = {int(ticks): reported[ticks] / newton[ticks] for ticks in reported if ticks != "ticks at rest"}
    first, factor = PAGE.numbers("from # ticks on it is within a factor of # of Newton's step")
    assert all(1 / factor <= ratio <= factor for ticks, ratio in ratios.items() if ticks >= first)
    assert all(ratio > factor for ticks, ratio in ratios.items() if ticks < first)  # "it is too large"
    _, told = PAGE.tsv_rows("not-at-rest")
    motions = told["160 ticks: median"], 160, told["160 ticks: most"]
    PAGE.assert_sentence("moved on by # times that distance in # ticks (median), at most # times", *motions)


def test_patterns():
    bodies = [
        [re.fullmatch(r"([A-C]) (\S+) (\S+) (\S+?)(\*?)", str(row[pace])).groups() for pace in row if "pace" in pace]
        for row in PAGE.tsv_rows("patterns")
    ]
    assert {len({pattern for pattern, *_ in runs}) for runs in bodies} == {1, 2, 3}  # "one to three patterns"
    range_of = lambda values: 100 * (max(values) / min(values) - 1)
    within = [
        range_of([float(index) for pattern, index, *_, restless in runs if pattern == letter and not restless])
        for runs in bodies
        for letter in {pattern for pattern, *_, restless in runs if not restless}
    ]
    between = [[range_of([float(run[column]) for run in runs]) for runs in bodies] for column in (1, 2)]
    PAGE.assert_sentence("the pace changes GI by # % at most, at rest", max(within), tolerance=0.051)
    PAGE.assert_sentence("differs by up to # %, the wavelength by up to # %", *map(max, between), tolerance=0.51)
    # the slow pattern of one body has less energy than the fast one, that of another has more
    slower = [float(runs[-1][3]) / float(runs[0][3]) - 1 for runs in bodies]
    assert min(slower) < -0.02
    assert max(slower) > 0.02


def test_work_and_errors_of_nested_meshes():
    rows = PAGE.tsv_rows("nested")
    work = [row["work"] for row in rows if row["scene"] == "fig6-thick"]
    PAGE.assert_sentence("take # to # of the work of `finest`", *spread(work))
    seeds = [row for row in rows if (row["scene"], row["law"]) == ("fig6-thick", "isotropic")]
    assert (len(seeds), len(rows)) == (6, 11)
    mean_error = np.mean([per_cent(row["GI, g = 2"]) for row in seeds])
    PAGE.assert_sentence("have a GI # % lower", -mean_error, tolerance=0.051)
    count, limit = PAGE.numbers("lower on average; # have its wavelength within # %")
    assert sum(abs(per_cent(row["wavelength, g = 2"])) <= limit for row in seeds) == count
    assert "[all 11 runs](solver-nested.tsv)" in PAGE.prose


def test_first_wrinkles_of_strips():
    late, short = [], []
    for row in PAGE.tsv_rows("first-wrinkles"):
        theory_g, theory_wave = map(float, re.findall(r"[\d.]+", row["theory: g, wave"]))
        late += [abs(float(g) - theory_g) for g in re.findall(r"[\d.]+", row["g at an rms of 0.1 T"])]
        short += [100 * (1 - float(wave) / theory_wave) for wave in re.findall(r"[\d.]+", row["wave"])]
    PAGE.assert_sentence("an rms of 0.1 T within # of theory's g", max(late))
    PAGE.assert_sentence("in waves up to # % shorter", max(short), tolerance=0.5)


def test_onset_and_tangent():
    differences = [
        abs(per_cent(row[f"tangent, {mesh} T"]) - per_cent(row[f"onset, {mesh} T, pace {pace}"]))
        for row in PAGE.tsv_rows("onset")
        for mesh, pace in (("1.64", "1"), ("1.09", "½"))
    ]
    PAGE.assert_sentence("Onset and tangent differ by # % of g at most", max(differences), tolerance=0.051)


def test_shallow_notches_open_near_the_growth_of_creases():
    opens = [
        row[key]
        for row in PAGE.tsv_rows("notches")
        if str(row["depth, width, T"]).startswith("1/50")
        for key in ("opens, 0.1 T", "opens, 0.05 T")
    ]
    (limit,) = PAGE.numbers("open within # of theory's")
    assert max(abs(g - theory.CREASE ** (1 / 3)) for g in opens if g != "–") <= limit


def test_single_precision():
    rows = {str(row.pop("quantity")): [*row.values()] for row in PAGE.tsv_rows("single-precision")}
    shares = [float(share) for cell in rows["whole run to g = 2"] for share in re.findall(r"[\d.]+", str(cell))]
    PAGE.assert_sentence("Runs take # to # of the time, with the same errors", *spread(shares))
    for name in ("error of radius, 64 and 32 bits", "error of hoop stress"):
        pairs = [[float(error) for error in re.findall(r"[\d.]+", str(cell))] for cell in rows[name]]
        assert all(abs(pair[1] / pair[0] - 1) < 0.02 for pair in pairs if pair)

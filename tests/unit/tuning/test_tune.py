"""The search as a whole, over runs whose losses are a known function of the parameters."""

import hashlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import PARAMETERS, Configuration, loads, preset
from gridslam.errors import ArgumentError, ConfigurationError, InputError
from gridslam.parameters import to_table
from gridslam.tuning.comparison import Pair, compare
from gridslam.tuning.report import describe_verdict, to_document, to_toml
from gridslam.tuning.search_space import SearchSpace
from gridslam.tuning.tune import Settings, TunedLog, Tuner

NAMES = "key_scan_m", "noise_m", "tempering"
TARGET = {"key_scan_m": 0.3, "noise_m": 0.05, "tempering": 0.01}
LOGS = [TunedLog("a", "a.clf", "1"), TunedLog("b", "b.clf", "2", held_out=True)]
SPACE = SearchSpace.of(Configuration(), NAMES)
SETTINGS = Settings(Configuration(), SPACE, 60)


class Runs:
    """Answers jobs; the loss depends on the distance to the target, and on noise of its own for each job."""

    def __init__(self, sensitivity=1.0, noise=0.05, fails=lambda values: False, target=TARGET):
        self.sensitivity, self.noise, self.fails = sensitivity, noise, fails
        self.target = target
        self.jobs = []

    def __call__(self, jobs):
        self.jobs += jobs
        return [self.row(job) for job in jobs]

    def row(self, job):
        table = to_table(loads(job.configuration))
        values = {
            "key_scan_m": table["when_to_update"]["translation_m"],
            "noise_m": table["motion"]["sigma_xy_m"],
            "tempering": table["sensor"]["tempering"],
        }
        row = {"status": "failed", "document": None, "message": "out of luck", "error": "InputError"}
        if self.fails(values):
            return row
        away = sum(math.log(values[name] / self.target[name]) ** 2 for name in NAMES)
        seed = int(hashlib.sha256(job.key.encode()).hexdigest()[:8], 16)
        noise = self.noise * np.random.default_rng(seed).standard_normal()
        loss = math.exp(self.sensitivity * away + noise)
        return row | {"status": "done", "document": {"evaluation": {"ate": {"trans_rmse_m": loss}}}}


def test_a_real_gain_is_found_and_recommended():
    tuning = Tuner(SETTINGS, LOGS, Runs())()
    assert tuning.gains
    assert tuning.comparison.ratio < 0.3
    for name in NAMES:
        assert abs(math.log(tuning.best.values[name] / TARGET[name])) < 0.7
    assert tuning.configuration == SPACE.apply(Configuration(), tuning.best.values)
    assert describe_verdict(tuning, LOGS)[0].startswith("gain: the error of the best is 0.")


def test_where_nothing_matters_the_start_is_kept():
    """The same distribution for all configurations: the best of 12 is so by luck, which fresh seeds do not share."""
    space = SearchSpace.of(Configuration(), NAMES)
    recommended = 0
    for seed in range(60):
        tuning = Tuner(Settings(Configuration(), space, 12, seed=10_000 * seed), LOGS, Runs(sensitivity=0.0))()
        recommended += tuning.gains
        if not tuning.gains:
            assert tuning.configuration == Configuration()
    assert recommended <= 5  # of 60; 2.5 % are expected, and more than 8 % once in 250


def test_trials_are_trials_and_too_few_are_reported_as_such():
    start = SPACE.values_of(Configuration())
    runs = Runs(sensitivity=5.0, noise=0.0, target=start)
    tuning = Tuner(replace(SETTINGS, trials=6), LOGS, runs)()
    assert len(tuning.trials) == 6
    tried = {tuple(trial.values.items()) for trial in tuning.trials}
    assert len(tried) == 6
    assert tuple(start.items()) not in tried, "the start is no trial"
    assert not tuning.gains
    assert tuning.best.values == start
    assert describe_verdict(tuning, LOGS)[1] == ("6 trials are too few to exclude a gain: 9 or more are advised")
    many = Tuner(replace(SETTINGS, trials=12), LOGS, runs)()
    assert len(describe_verdict(many, LOGS)) == 1
    assert len({tuple(trial.values.items()) for trial in many.trials}) == 12


def test_the_same_seed_gives_the_same_bytes_and_another_one_others():
    texts = []
    for seed in (0, 0, 1):
        settings = replace(SETTINGS, seed=seed)
        tuner = Tuner(settings, LOGS, Runs())
        tuning = tuner()
        texts.append(json.dumps(to_document(tuning, settings, LOGS, settings.trials)) + to_toml(tuning, LOGS))
    assert texts[0] == texts[1] != texts[2]


def test_failures_rank_last_and_a_start_that_fails_ends_it():
    tuning = Tuner(SETTINGS, LOGS, Runs(fails=lambda values: values["key_scan_m"] > 0.6))()
    assert any(math.isinf(trial.ratio) for trial in tuning.trials)
    assert tuning.best.values["key_scan_m"] <= 0.6
    assert json.dumps(to_document(tuning, SETTINGS, LOGS, 60), allow_nan=False)
    with pytest.raises(InputError, match=r"a\.clf: the configuration that the search begins with fails: out of luck"):
        Tuner(SETTINGS, LOGS, Runs(fails=lambda values: True))()
    with pytest.raises(ArgumentError, match="at least one that is not held out"):
        Tuner(SETTINGS, LOGS[1:], Runs())


def test_a_held_out_log_that_cannot_be_mapped_ends_it_before_the_search():
    runs = Runs()
    failed = {"status": "failed", "document": None, "message": "too short"}

    def run(jobs):
        return [failed if job.log == "b.clf" else row for job, row in zip(jobs, runs(jobs), strict=True)]

    with pytest.raises(InputError, match=r"b\.clf: the configuration that the search begins with fails: too short"):
        Tuner(SETTINGS, LOGS, run)()
    assert len(runs.jobs) == 2


def test_a_held_out_log_is_run_no_more_often_than_it_judges():
    runs = Runs()
    assert Tuner(SETTINGS, LOGS, runs)().best.ratio < 1
    assert sum(job.log == "b.clf" for job in runs.jobs) == 2 * SETTINGS.judging_seeds


def test_the_file_is_a_configuration():
    tuning = Tuner(SETTINGS, LOGS, Runs())()
    text = to_toml(tuning, LOGS)
    assert text.startswith("# gridslam tune, version ")
    assert loads(text) == tuning.configuration


def _pairs(rng, gain, logs, seeds, log_deviation=0.0, seed_deviation=0.1):
    """Logs differ in how hard they are and in what they gain; seeds are noise on top."""
    return [
        Pair(f"log{k}", seed, hard + seed_deviation * one, hard + gain + of_log + seed_deviation * other)
        for k, (hard, of_log) in enumerate(zip(rng.normal(0, 2, logs), rng.normal(0, log_deviation, logs), strict=True))
        for seed, (one, other) in enumerate(rng.standard_normal((seeds, 2)))
    ]


@pytest.mark.parametrize(("logs", "seeds"), [(1, 5), (3, 5), (6, 3), (12, 2)])
def test_without_a_gain_hardly_ever_one_is_claimed(logs, seeds):
    """The upper limit of a 95 % interval is below 1 in 2.5 % of such comparisons: more than 5 % of 200, 10, have a
    probability of 1 % for each case; the seeds are fixed."""
    claimed = sum(
        compare(_pairs(np.random.default_rng(seed), 0.0, logs, seeds, 0.2 if logs >= 4 else 0.0)).gains
        for seed in range(200)
    )
    assert claimed <= 10


@pytest.mark.parametrize(("logs", "seeds"), [(1, 5), (6, 3)])
def test_a_real_gain_is_found(logs, seeds):
    """20 % with seeds that differ by 5 %: three standard errors and more."""
    found = [
        compare(_pairs(np.random.default_rng(seed), math.log(0.8), logs, seeds, 0.02, 0.05)) for seed in range(100)
    ]
    assert sum(one.gains for one in found) >= 95
    assert np.median([one.ratio for one in found]) == pytest.approx(0.8, rel=0.02)


def test_many_logs_count_as_logs():
    """One that gains much in all of its seeds is one observation, and proves nothing about others."""
    rng = np.random.default_rng(0)
    pairs = [Pair("a", seed, 0.0, -1.0) for seed in range(50)]
    others = [Pair(name, 0, 0.0, float(rng.normal(0, 0.1))) for name in "bcde"]
    found = compare(pairs + others)
    assert (found.units, found.observations) == ("logs", 5)
    assert not found.gains
    assert compare(pairs[:5]).units == "runs"


def test_failures_count_and_forbid():
    good = [Pair("a", seed, 0.0, -1.0 - 0.01 * seed) for seed in range(5)]
    assert compare(good).gains
    failed = compare([*good, Pair("a", 5, 0.0, math.inf)])
    assert failed.failed == 1
    assert not failed.gains
    rescued = compare([Pair("a", seed, math.inf, 0.01 * seed) for seed in range(5)])
    assert rescued.gains
    assert rescued.ratio == pytest.approx(0.1)


DEFAULT = Configuration()


def test_all_parameters_with_a_range_are_searched_and_no_others():
    space = SearchSpace.of(DEFAULT)
    assert [one.name for one in space.dimensions] == [name for name, one in PARAMETERS.items() if one.search]
    assert {"particles", "range_min_m", "lost_below"}.isdisjoint(one.name for one in space.dimensions)


@pytest.mark.parametrize("end", ["low", "high"])
def test_ends_are_valid_and_the_default_is_itself(end):
    space = SearchSpace.of(DEFAULT)
    values = space.round({one.name: getattr(one.search, end) for one in space.dimensions})
    assert space.values_of(space.apply(DEFAULT, values)) == values
    assert space.apply(DEFAULT, space.values_of(DEFAULT)) == DEFAULT


def test_parameters_of_another_kind_are_left_out():
    of_gmapping = [one.name for one in SearchSpace.of(preset("gmapping")).dimensions]
    assert "beam_sigma_m" not in of_gmapping
    assert "key_scan_m" in of_gmapping
    with pytest.raises(ConfigurationError, match="beam_sigma_m: cannot be tuned; expected one of resolution_m"):
        SearchSpace.of(preset("gmapping"), ["beam_sigma_m"])

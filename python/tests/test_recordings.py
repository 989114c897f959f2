"""Data frames and CSV files as data of `identify`."""

import csv
import json
import os
import pathlib
import re
import shutil
import subprocess
import warnings

import numpy as np
import pytest

import physgrad as pg

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENE, DATA = (ROOT / "examples/data" / f"double_pendulum.{kind}" for kind in ("toml", "csv"))
MASS = {"system.pole_mass": 0.1}
COLUMNS = ["t", "x", "x_dot", "theta_1", "omega_1", "force"]


class Frame:
    """What a data frame has, without pandas."""

    def __init__(self, columns):
        self.data = {name: np.asarray(values) for name, values in columns.items()}
        self.columns = list(self.data)

    def __getitem__(self, name):
        return self.data[name]

    def __len__(self):
        return len(next(iter(self.data.values())))


def task():
    return pg.task("cart_pole", poles=1, horizon=40, pole_mass=0.17, precision="f64")


def recordings(count=3, of=None):
    """Exact pairs with the mass 0.17 kg, and the same as columns of a table with segments."""
    of = of or task()
    x, u = pg.rollout(of, pg.Mlp(of, [8], seed=1, zero_init_output=False), of.starts(count, seed=1))
    pairs = [(x[i, :-1], u[i]) for i in range(count)]
    rows = np.concatenate([np.column_stack([0.01 * np.arange(40), x, u]) for x, u in pairs])
    table = {"segment": np.repeat([f"run {i}" for i in range(count)], 40)}
    return pairs, table | dict(zip(["t", *task().state_names, *task().control_names], rows.T))


def write(path, table, places=17):
    """Writes a CSV file. NaN is an empty cell."""
    def text(cell):
        return cell if isinstance(cell, str) else "" if np.isnan(cell) else format(cell, f".{places}g")

    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([list(table), *([text(cell) for cell in row] for row in zip(*table.values()))])
    return path


def same(one, other):
    """Whether two fits have equal bits."""
    assert one.values == other.values and one.errors == other.errors and one.chi_squared == other.chi_squared
    for a, b in zip(one.states, other.states, strict=True):
        np.testing.assert_array_equal(a, b)


def test_frames_files_and_pairs_give_the_same_fit(tmp_path):
    pairs, table = recordings()
    expected = pg.identify(task(), pairs, MASS)
    assert np.isclose(expected.values["system.pole_mass"], 0.17, rtol=1e-6)
    path = write(tmp_path / "measured.csv", table)
    parts = [Frame({name: column[i * 40 : i * 40 + 40] for name, column in table.items()}) for i in range(3)]
    for data in (Frame(table), path, str(path), parts, [parts[0], pairs[1], {"x": pairs[2][0], "u": pairs[2][1]}]):
        same(pg.identify(task(), data, MASS), expected)
    one = {"x": pairs[0][0], "u": pairs[0][1]}
    same(pg.identify(task(), one, MASS), pg.identify(task(), pairs[:1], MASS))


def test_pandas_frames_need_no_conversion():
    pandas = pytest.importorskip("pandas")
    pairs, table = recordings()
    expected = pg.identify(task(), pairs, MASS)
    frame = pandas.DataFrame(table)
    same(pg.identify(task(), frame, MASS), expected)
    same(pg.identify(task(), [part for _, part in frame.groupby("segment")], MASS), expected)
    same(pg.identify(task(), frame.set_index(["segment", "t"]), MASS), expected)
    nullable = frame.astype({"theta_1": "Float64"})
    nullable.loc[7, "theta_1"] = pandas.NA
    pairs[0][0][7, 2] = np.nan
    same(pg.identify(task(), nullable, MASS), pg.identify(task(), pairs, MASS))
    frame["t"] = pandas.to_timedelta(frame["t"], unit="s")
    with pytest.raises(TypeError, match=r"column `t` has dates or durations; .*total_seconds"):
        pg.identify(task(), frame, MASS)


def test_a_file_gives_the_numbers_of_the_program(tmp_path):
    program = os.environ.get("PHYSGRAD", shutil.which("physgrad")) or pytest.skip("set PHYSGRAD to the program")
    if not SCENE.exists():
        pytest.skip("the data are not beside the package")
    noise = {"theta_1": 0.003, "omega_1": 0.1, "theta_2": 0.003, "omega_2": 0.1}
    given = ",".join(f"{name}={value}" for name, value in noise.items())
    options = ["--data", str(DATA), "--noise", given, "--every", "2", "--window", "8", "--json", "-o", str(tmp_path / "out")]
    done = subprocess.run([program, "identify", str(SCENE), *options], check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = pg.identify(pg.scene(SCENE), DATA, noise=noise, every=2, window=8)
    for row in found["numbers"]:
        name = row["name"]
        error = None if np.isnan(fit.errors[name]) else fit.errors[name]
        ours = [fit.starts[name], fit.values[name], error, fit.statuses[name]]
        assert ours == [row["start"], row["value"], row["standard_error"], row["status"]]
    assert found["fit"]["measurements"] == fit.measurements and found["fit"]["BIC"] == round(fit.bic, 1)
    assert found["fit"]["unknowns with initial states"] == fit.unknowns
    assert "there is no column torque, which is taken as 0 in all rows" in fit.notes and fit.notes[0] == found["notes"][0]
    with open(tmp_path / "out" / "validation.csv") as file:
        rows = list(csv.DictReader(file))
    simulated = [[float(row[f"{name}_simulated"]) for name in pg.scene(SCENE).state_names] for row in rows]
    seen = [states[~np.isnan(x).all(axis=1)] for states, x in zip(fit.validation.states, fit.validation.measured)]
    np.testing.assert_array_equal(np.concatenate(seen), simulated)


SCENE_OF_ONE_POLE = """scene = 1
task = "cart_pole"
precision = "f64"
[system]
poles = 1
[fit]
"system.pole_mass" = { start = 0.1 }
"""


def test_the_program_and_python_read_one_table(tmp_path, monkeypatch):
    program = os.environ.get("PHYSGRAD", shutil.which("physgrad"))
    if program is None:
        pytest.skip("set PHYSGRAD to the program")
    scene, path = tmp_path / "scene.toml", tmp_path / "measured.csv"
    scene.write_text(SCENE_OF_ONE_POLE)
    task = pg.scene(scene)

    def both():
        command = [program, "identify", "scene.toml", "--data", "measured.csv", "--json", "-o", "out"]
        done = subprocess.run(command, capture_output=True, text=True)
        try:
            fit = pg.identify(task, "measured.csv")
        except ValueError as error:
            assert done.returncode == 1 and str(error).split() == done.stderr.split()[1:]
            return str(error)
        found = json.loads(done.stdout)
        assert found["notes"] == fit.notes and found["fit"]["segments"] == len(fit.states)
        assert [row["value"] for row in found["numbers"]] == list(fit.values.values())
        return fit

    table = recordings()[1]
    # A gap, empty rows over which the control changes, and empty cells of a state and of a control.
    for name in COLUMNS[1:]:
        table[name][50:53] = np.nan
    table["theta_1"][7] = table["force"][100] = np.nan
    keep = np.delete(np.arange(120), [20, 21])
    monkeypatch.chdir(tmp_path)
    write(path, {name: column[keep] for name, column in table.items()})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = both()
    assert [len(x) for x in fit.states] == [20, 18, 10, 27, 40]
    gaps = "a new segment begins at 2 rows after a gap in which a control changes (first: measured.csv:22)"
    assert fit.notes[0].startswith(gaps)
    lines = path.read_text().splitlines()
    for text, message in [
        ("\n".join([*lines[:3], lines[3] + ","]), "measured.csv:4: the line ends in a comma, but"),
        ("\n".join([*lines[:3], *lines[60:62], lines[3]]), "measured.csv:6: the rows of segment run 0 are not"),
        ("t;x;force\n0;1,5;0\n", "the columns are separated by semicolons, and numbers have decimal commas"),
        ("t,x,force\n0,1,0\n0.01,1,\n0.01,1,0\n", "measured.csv:4: the time 0.01 s is not later"),
    ]:
        path.write_text(text)
        assert message in both()


def test_missing_rows_and_cells_are_missing_states():
    pairs, table = recordings(1)
    x, u = pairs[0]
    # A control that holds its value over a gap is known there.
    u[10:14] = u[10]
    x[:] = task().replace(pole_mass=0.17).starts(1, seed=1)[0, :4]
    for t in range(39):
        x[t + 1] = task().step(x[t : t + 1], u[t : t + 1])[0]
    table = dict(zip(COLUMNS, np.column_stack([0.01 * np.arange(40), x, u]).T))
    keep = np.delete(np.arange(40), [11, 12])
    table = {name: column[keep] for name, column in table.items()}
    table["x_dot"][3] = np.nan
    del table["omega_1"]
    x[[11, 12]] = np.nan
    x[3, 1] = np.nan
    x[:, 3] = np.nan
    fit = pg.identify(task(), Frame(table), MASS)
    same(fit, pg.identify(task(), [(x, u)], MASS))
    assert len(fit.states) == 1 and np.isnan(fit.measured[0][11]).all() and "omega_1" not in fit.rms


def test_a_gap_in_which_a_control_changes_begins_a_new_segment():
    pairs, table = recordings(1)
    keep = np.delete(np.arange(40), [20, 21])
    frame = Frame({name: column[keep] for name, column in table.items()})
    fit = pg.identify(task(), frame, MASS)
    assert [len(x) for x in fit.states] == [20, 18] and fit.times[1][0] == pytest.approx(0.22)
    assert fit.notes == [
        "a new segment begins at 1 row after a gap in which a control changes (first: the data frame, "
        "row 20); add rows with the control to join them"
    ]
    assert fit.values["system.pole_mass"] == pytest.approx(0.17, rel=1e-6)
    # Empty rows are missing rows.
    table["force"][[20, 21]] = np.nan
    for name in COLUMNS[1:5]:
        table[name][[20, 21]] = np.nan
    empty = pg.identify(task(), Frame(table), MASS)
    same(empty, fit)
    assert empty.notes == [fit.notes[0].replace("row 20", "row 22")]
    table = recordings(1)[1]
    # Rows that are all several steps apart have no gap: the fit holds the controls, and says so.
    every_second = Frame({name: column[::2] for name, column in table.items()})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = pg.identify(task(), every_second, MASS)
    assert len(fit.states) == 1 and fit.notes[0].startswith("the rows are 2 steps apart, and the fit holds each control")


def test_controls_hold_their_values_and_begin_at_zero():
    pairs, table = recordings(1)
    table["force"][:5] = np.nan
    table["force"][10:20] = np.nan
    x, u = pairs[0]
    u[:5], u[10:20] = 0.0, u[9]
    options = {"params": MASS, "noise": [0.1] * 4}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        same(pg.identify(task(), Frame(table), **options), pg.identify(task(), [(x, u)], **options))
        del table["force"]
        fit = pg.identify(task(), Frame(table), **options)
        same(fit, pg.identify(task(), [(x, 0 * u)], **options))
    assert fit.notes == ["there is no column force, which is taken as 0 in all rows"]


def test_units_convert_columns_and_noise(tmp_path):
    pairs, table = recordings()
    rng = np.random.default_rng(0)
    for name, size in zip(task().state_names, [0.001, 0.01, 0.002, 0.02]):
        table[name] += size * rng.normal(size=len(table[name]))
    expected = pg.identify(task(), Frame(table), MASS, [0.001, 0.01, 0.002, 0.02])
    turned = {"theta_1": "deg", "omega_1": "rpm", "x": "mm", "x_dot": 0.1, "t": "ms"}
    factors = {"theta_1": np.pi / 180, "omega_1": 2 * np.pi / 60, "x": 1e-3, "x_dot": 0.1, "t": 1e-3}
    changed = {name: column / factors[name] if name in factors else column for name, column in table.items()}
    noise = {name: value / factors[name] for name, value in zip(["x", "x_dot", "theta_1", "omega_1"], [0.001, 0.01, 0.002, 0.02])}
    for data in (Frame(changed), write(tmp_path / "measured.csv", changed)):
        fit = pg.identify(task(), data, MASS, noise, units=turned)
        assert fit.values["system.pole_mass"] == pytest.approx(expected.values["system.pole_mass"], rel=1e-7)
        assert fit.errors["system.pole_mass"] == pytest.approx(expected.errors["system.pole_mass"], rel=1e-6)
        np.testing.assert_allclose(fit.noise, expected.noise, rtol=1e-12)
        np.testing.assert_allclose(fit.measured[1], expected.measured[1], atol=1e-12)
    for units, message in [
        ({"theta_1": "degrees"}, "the unit 'degrees' of `theta_1` is unknown; allowed: products and quotients"),
        ({"theta": "deg", "t": "ms"}, "`units`: there is no column `theta`; columns: "),
        ({"t": "mm"}, "`units`: 'mm' of `t` does not convert to 's', the unit of the task"),
        ({"x": 0}, "the factor of `x` is 0; allowed: a finite number other than 0"),
    ]:
        with pytest.raises(ValueError, match=re.escape(message)):
            pg.identify(task(), Frame(changed), MASS, units=units)


def test_units_convert_to_those_of_a_system():
    own = pg.system(
        lambda x, u, p: [p.gain * u.pump - x.level], states=["level"], controls=["pump"], params={"gain": 1.0},
        dt=0.1, units={"level": "cm"},
    )
    x = np.zeros((20, 1))
    for t in range(19):
        x[t + 1] = own.replace(gain=2.0).step(x[t : t + 1], np.ones((1, 1)))[0]
    # With one decimal, 0.3 s is the third step of 0.1 s.
    frame = Frame({"time": np.round(0.1 * np.arange(20), 1), "level": 10 * x[:, 0], "pump": np.ones(20)})
    fit = pg.identify(own, frame, ["gain"], units={"level": "mm"})
    assert fit.values == {"system.parameters.gain": pytest.approx(2.0, rel=1e-9)}
    with pytest.raises(ValueError, match="`units`: 'deg' of `level` does not convert to 'cm'"):
        pg.identify(own, frame, ["gain"], units={"level": "deg"})


def test_times_may_be_rounded_and_begin_late():
    pairs, table = recordings(1)
    third = task().replace(dt=1 / 30)
    rounded = table | {"t": np.round(np.arange(40) / 30 + 0.1, 3)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = pg.identify(third, Frame(rounded), MASS)
    assert len(fit.states[0]) == 40 and fit.times[0][[0, -1]] == pytest.approx([0.1, 1.4])
    gusts = {"gusty_wind": {"gust": 8.0, "period": 0.5}}
    windy = task().replace(horizon=80, effects=gusts)
    start = windy.starts(1, seed=1)
    x, u = pg.rollout(windy, pg.Mlp(windy, [8], seed=1, zero_init_output=False), start)
    late = dict(zip(COLUMNS, np.column_stack([0.01 * np.arange(20, 80), x[0, 20:-1], u[0, 20:]]).T))
    late["start_of_gusts"] = np.full(60, start[0, -1])
    fit = pg.identify(windy.replace(cart_mass=1.3), Frame(late), ["system.cart_mass"])
    assert fit.values["system.cart_mass"] == pytest.approx(1.0, rel=1e-6)
    stamped = {"stamp" if name == "t" else name: column for name, column in late.items()}
    same(pg.identify(windy.replace(cart_mass=1.3), Frame(stamped), ["system.cart_mass"], time="stamp"), fit)


REFUSED = [
    ({"angle": 0.0}, "unknown column `angle`; leave it out; allowed: segment, t, x, x_dot, theta_1, omega_1, force"),
    ({"t": None}, "there is no column `t` with the time in s"),
    ({"x": None, "x_dot": None, "theta_1": None, "omega_1": None}, "there is no column of a state; states: x, x_dot"),
    ({"time": 0.0}, "the columns `t` and `time` have one meaning; remove one of them"),
    ({"t": [0.0, 0.01, 0.015, 0.02]}, "row 2: the time 0.015 s is not a later step of 0.01 s; resample, or"),
    ({"t": [0.0, 0.02, 0.01, 0.03]}, "row 2: the time 0.01 s is not later than in the row before; sort the rows"),
    ({"t": [0.0, np.nan, 0.02, 0.03]}, "row 1: the time is missing"),
    ({"t": [0, 10, 20, 30]}, "all rows are 1000 or more steps of 0.01 s apart; give the time in s, or its unit"),
    ({"t": [0.0, 0.01, 0.02, 9.0]}, "row 3: the row is 898 steps of 0.01 s after the row before"),
    ({"x": [0.0, np.inf, 0.0, 0.0]}, "row 1: `x` is infinite; leave the cell of a missing sample empty"),
    ({"force": [np.nan] * 4}, "the column `force` is empty; give the control of every row"),
    ({"segment": ["a", "b", "b", "a"]}, "row 3: the rows of segment a are not contiguous"),
]


@pytest.mark.parametrize("change, message", REFUSED, ids=[message[:24] for _, message in REFUSED])
def test_tables_that_fit_no_task_are_refused(change, message, tmp_path):
    table = {"t": 0.01 * np.arange(4), **{name: np.zeros(4) for name in COLUMNS[1:]}}
    for name, values in change.items():
        if values is None:
            del table[name]
        else:
            table[name] = np.broadcast_to(values, 4)
    with pytest.raises(ValueError, match=re.escape(message)):
        pg.identify(task(), Frame(table), MASS)
    path = write(tmp_path / "measured.csv", table)
    if "inf" not in path.read_text():
        in_file = re.sub(r"^row (\d)", lambda row: f"measured.csv:{int(row[1]) + 2}", message)
        with pytest.raises(ValueError, match=re.escape(in_file)):
            pg.identify(task(), path, MASS)


def test_files_that_are_no_tables_are_refused(tmp_path):
    path = tmp_path / "measured.csv"
    for text, message in [
        ("", "has no samples"),
        ("t;x\n0;1\n", "the columns are separated by semicolons; allowed: commas, and points in numbers"),
        ("t;x\n0;1,5\n", "semicolons, and numbers have decimal commas; allowed: commas, and points"),
        ("t;x\n0;1,5\n", "replace commas by points first, and then semicolons by commas"),
        ("t\tx\n0\t1,5\n", 'measured.csv", sep="\\t", decimal=",").to_csv('),
        ("t,x\n\n0,1\n\n\n0.01,one\n", "measured.csv:6: `one` in column `x` is not a number"),
        ("t,x\n0,1,2\n", "measured.csv:2: the row has 3 cells; expected 2"),
        ("# by a sensor\nt,x\n0,one\n", "measured.csv:3: `one` in column `x` is not a number"),
        ("t,x\n0,1_0\n", "measured.csv:2: `1_0` in column `x` is not a number"),
        ("t,x\n0,1\n# end,\n", "measured.csv:3: the line begins with `#`; comments are allowed"),
        ("t,x,\n0,1,\n", "column 3 has no name; remove the column"),
        (b"\xff\xfet,x", "is in UTF-16 or is no text; save it as text in UTF-8"),
    ]:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(ValueError, match=re.escape(message)):
            pg.identify(task(), path, MASS)
    x, u = recordings(1)[0][0]
    with pytest.raises(TypeError, match=r"`data\[0\]` is of type ndarray; allowed: a data frame, .* or a pair, as in \[\(x, u\)\]"):
        pg.identify(task(), (x, u), MASS)
    with pytest.raises(FileNotFoundError):
        pg.identify(task(), tmp_path / "missing.csv", MASS)
    with pytest.raises(ValueError, match="`units` is about columns; the data have no data frame and no CSV file"):
        pg.identify(task(), recordings()[0], MASS, units={"x": "mm"})


def test_columns_of_parameters_hold_for_a_segment():
    pairs, table = recordings(2)
    drawn = task().replace(cart_mass={"uniform": [0.5, 1.5]})
    table["system.cart_mass"] = np.ones(80)
    fit = pg.identify(drawn, Frame(table), MASS)
    same(fit, pg.identify(drawn, [{"x": x, "u": u, "p": {"system.cart_mass": 1.0}} for x, u in pairs], MASS))
    assert fit.values["system.pole_mass"] == pytest.approx(0.17, rel=1e-6)
    # A column of a number that the fit replaces is ignored, as by the program.
    for values in (np.full(80, 3.0), np.full(80, np.nan)):
        frame = Frame(table | {"system.pole_mass": values})
        same(pg.identify(drawn, frame, MASS), fit)
        same(pg.identify(drawn.replace(pole_mass={"start": 0.1}), frame), fit)
        same(pg.identify(drawn.replace(pole_mass={"uniform": [0.1, 0.2]}), frame, MASS), fit)
    for values, message in [
        (np.r_[np.ones(79), 2.0], "row 79: `system.cart_mass` differs from an earlier row"),
        (
            np.r_[np.full(40, np.nan), np.ones(40)],
            "row 0: segment run 0: the column `system.cart_mass` has no value; give it in every segment",
        ),
    ]:
        with pytest.raises(ValueError, match=re.escape(message)):
            pg.identify(drawn, Frame(table | {"system.cart_mass": values}), MASS)


def test_an_output_of_the_actuator_is_no_control():
    limited = task().replace(actuator={"limit": {"bound": 10.0}})
    _, table = recordings(1, limited)
    table["force_applied"] = table["force"]
    assert pg.identify(limited, Frame(table), MASS).values["system.pole_mass"] == pytest.approx(0.17, rel=1e-6)
    del table["force"]
    with pytest.raises(ValueError, match="the column `force` is missing; `force_applied` is the output of the actuator"):
        pg.identify(limited, Frame(table), MASS)

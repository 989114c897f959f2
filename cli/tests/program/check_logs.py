"""Reads event files with TensorBoard, and compares their scalars with `metrics.csv`.

Run: python check_logs.py RUN ...
"""

import csv
import pathlib
import sys

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

for run in map(pathlib.Path, sys.argv[1:]):
    rows = list(csv.DictReader(open(run / "metrics.csv")))
    events = EventAccumulator(str(run))
    events.Reload()
    names = [name for name in rows[0] if name != "epoch" and any(row[name] for row in rows)]
    assert sorted(events.Tags()["scalars"]) == sorted(names), events.Tags()
    for name in names:
        expected = [(int(row["epoch"]), np.float32(row[name])) for row in rows if row[name]]
        found = [(event.step, np.float32(event.value)) for event in events.Scalars(name)]
        assert found == expected, f"{run.name}: {name}: {found}, {expected}"
    print(f"{run.name}: {len(names)} scalars, {len(rows)} epochs")

"""The limits of a container are those of the machine, where they are the narrower ones."""

import math

import pytest

from clunk.sweeping import machine


@pytest.mark.parametrize(
    ("files", "cores", "memory"),
    [
        ({}, 8, 2.0**34),
        ({"cpu.max": "max 100000\n", "memory.max": "max\n"}, 8, 2.0**34),
        ({"cpu.max": "150000 100000\n", "memory.max": "536870912\n"}, 2, 2.0**29),
        ({"cpu.max": "1000 100000\n"}, 1, 2.0**34),
        ({"cpu.max": "6400000 100000\n", "memory.max": f"{2**40}\n"}, 8, 2.0**34),
        ({"cpu.max": "nonsense", "memory.max": ""}, 8, 2.0**34),
    ],
)
def test_the_narrower_limit_counts(files, cores, memory, tmp_path, monkeypatch):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(machine, "_CONTAINER", tmp_path)
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(machine.os, "sysconf", {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 2**22}.__getitem__)
    assert machine.available_cores() == cores
    assert math.isclose(machine.available_memory(), memory)

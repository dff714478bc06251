"""Sweeps: cells, tiles, the engines that run them, finished parts on the disk and resuming, tolerances."""

"""Who else uses the machine while something is timed: from the processor times that Linux keeps."""

import os
import time
from pathlib import Path


class Watch:
    """Since `start`: what share of all cores went to processes other than this one and `children` (pids)."""

    def __init__(self, children: list[int]) -> None:
        self.processes = [os.getpid(), *children]
        self.start()

    def start(self) -> None:
        """Begin to count."""
        self.began = self._now()

    def others(self) -> float:
        """From 0 to 1, to about 2 % of a core over half a second; 0 where it cannot be told."""
        wall, busy, own = (now - then for now, then in zip(self._now(), self.began, strict=True))
        return max(0.0, busy - own) / (wall * (os.cpu_count() or 1))

    def wait(self, share: float, patience: float) -> None:
        """Until the others use less than this share for a fifth of a second, but no longer than `patience` [s]."""
        until = time.monotonic() + patience
        while time.monotonic() < until:
            self.start()
            time.sleep(0.2)
            if self.others() < share:
                return

    def _now(self) -> tuple[float, float, float]:
        """Wall time, and processor time of all processes and of those that are watched  [s]."""
        if not Path("/proc/stat").exists():
            return time.monotonic(), 0.0, 0.0
        tick = float(os.sysconf("SC_CLK_TCK"))
        machine = [int(word) for word in Path("/proc/stat").read_text().splitlines()[0].split()[1:]]
        user, nice, system, _, _, *rest = machine[:8]  # idle and waiting do not count; interrupts and stolen time do
        own = 0
        for pid in self.processes:
            words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
            own += int(words[11]) + int(words[12])
        return time.monotonic(), (user + nice + system + sum(rest)) / tick, own / tick

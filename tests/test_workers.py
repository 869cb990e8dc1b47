import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROGRAM = """
import os, time
from labrun.workers import pool

if __name__ == "__main__":
    with pool(2, None) as found:
        # as long as one of them sleeps, the other has to be started for the second
        jobs = [found.executor.submit(time.sleep, 0.5) for _ in range(4)]
        [job.result() for job in jobs]
        print(*(child for child in found.executor._processes), flush=True)
        time.sleep(600)
"""


def runs(pid: int) -> bool:
    state = Path(f"/proc/{pid}/stat")
    try:
        return state.read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:  # gone
        return False


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="looks at processes in /proc")
def test_workers_end_with_the_process_that_asked_even_if_it_is_killed(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    asked = subprocess.Popen([sys.executable, program], stdout=subprocess.PIPE, text=True)
    assert asked.stdout is not None
    workers = [int(pid) for pid in asked.stdout.readline().split()]
    assert len(workers) == 2
    assert all(runs(pid) for pid in workers)
    asked.send_signal(signal.SIGKILL)
    asked.wait()
    for _ in range(300):
        if not any(runs(pid) for pid in workers):
            return
        time.sleep(0.1)
    for pid in workers:
        os.kill(pid, signal.SIGKILL)
    pytest.fail("workers are left over")

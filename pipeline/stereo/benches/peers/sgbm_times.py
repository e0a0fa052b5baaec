"""Times of OpenCV's SGBM, with the settings of `tests/peers/sgbm.py`: LEFT RIGHT WIDTH HEIGHT DISPARITIES ROUNDS, where LEFT
and RIGHT are files of bytes. One line: the least seconds of a round, then seconds of CPU time a round. SGBM takes one thread
for a pair."""
import os
import sys
import time

import numpy as np

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../tests/peers"))
from sgbm import matcher  # noqa: E402

left, right, width, height, disparities, rounds = sys.argv[1:]
shape, rounds = (int(height), int(width)), int(rounds)
left, right = (np.fromfile(path, np.uint8).reshape(shape) for path in (left, right))
sgbm = matcher(disparities)
sgbm.compute(left, right)
times, cpu = [], time.process_time()
for _ in range(rounds):
    start = time.perf_counter()
    sgbm.compute(left, right)
    times.append(time.perf_counter() - start)
print(min(times), (time.process_time() - cpu) / rounds)

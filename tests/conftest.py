"""At least two threads for every test, also on one core: many compare one thread with two."""

import os

if int(os.environ.get("NUMBA_NUM_THREADS") or os.cpu_count() or 1) < 2:
    # Numba reads it when it is first imported.
    os.environ["NUMBA_NUM_THREADS"] = "2"

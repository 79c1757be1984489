"""One thread for the programs of XLA on a CPU, unless the user has asked for more.

Programs here are loops of small steps, which XLA is slower at when it spreads them over threads: a
map took a tenth to a third longer with two. And in jaxlib 0.10 to 0.12 a batch of LAPACK's holds a
thread while it waits for the others, so that two of them in one program may stop for ever. To be
set before JAX starts its threads. What uses several cores is several devices or processes.
"""

import os

os.environ.setdefault("PJRT_NPROC", "1")

"""Settings of the environment that JAX and OpenBLAS read when they are imported: import this first."""

import os
from pathlib import Path

import jaxlib.version

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads only fight over small matrices
os.environ.setdefault("LYAPHYBRID_ENGINE", "native")  # what only XLA can compile is an error
# XLA's programs are kept, for the next run and for processes that tests begin: half of the time of a second run.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[2] / "build" / "xla"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "0")
# XLA takes a preference for an instruction that this CPU lacks, and says so at length for each program that it loads.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

if jaxlib.version.__version_info__ < (0, 11):  # later ones have one way only, and end where a flag is unknown
    # References and eager code are thousands of small programs: in XLA's older way each takes half of the time.
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_cpu_use_fusion_emitters=false"

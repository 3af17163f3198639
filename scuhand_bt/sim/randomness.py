"""Random numbers by name: the same run seed, sample, attempt and device give the same draws.

numpy's `SeedSequence` is keyed by a hash of the names, so that one controller is compared with another on the
same draws, and workers and resumed runs agree with the run they continue.
"""

import hashlib

import numpy as np


def substream(seed: int, *names: str | int) -> np.random.Generator:
    """The generator of one device for one (sample, attempt); the names' order matters."""
    digest = hashlib.blake2b("\x1f".join(map(str, names)).encode(), digest_size=16).digest()
    words = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))

"""Named random streams: the same run seed, sample, attempt and device give the same draws.

The key of numpy's `SeedSequence` is a hash of the names. So controllers are compared on the same draws, and workers
and resumed runs agree with the run they continue.
"""

import hashlib

import numpy as np


def substream(seed: int, *names: str | int) -> np.random.Generator:
    """The generator of one device for one (sample, attempt); the order of the names matters."""
    digest = hashlib.blake2b("\x1f".join(map(str, names)).encode(), digest_size=16).digest()
    words = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))

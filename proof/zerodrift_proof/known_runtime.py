"""The texts of the runtime that were compared with the reference, by their hash.

The checker has no rules for intrinsics and for what a kernel does inside: kernels are taken at
their specification. That holds for the texts known here and no others, whatever runtime is beside a
model.
"""

import hashlib
import re
from collections.abc import Mapping

CURRENT: tuple[int, Mapping[str, str]] = (
    3,
    {
        "zd_exp2.h": "76f4ef56e0b433375242d475a7dc4851bff69e7c491849c9de327a0b4374a6bf",
        "zd_gru_columns.h": "8cc3b4664ed57bec7b72a25f0dc32b6ef53fcb470125b2ee3db7283825458619",
        "zd_gru_columns_avx2.h": "dd3645af2f4cb4520faf8162b94eb60bb364c3e6084c3b07d4618d204fea4ba0",
        "zd_gru_columns_sse2.h": "b60d775a619e12f6c1dde9a25f1e44f9d81d9c0dd2a595eb392b13df2c038079",
        "zd_gru_pairs.h": "767f80dcaa16a8c5b65887cc3b6fb629837443460c7daf5076bbd09bde846445",
        "zd_gru_portable.h": "10ad47580a56046ef8f32bef2ee6f3b2090b6e5ea3afd0a08f71b4b96fae925e",
        "zd_gru_rows.h": "991eb281e66de3d733f6532a2cd0e6c19280569930bebf4b83d0a51408f05592",
        "zd_layer_norm.h": "137220d78b476826864cf4116cd8ba1819f518c940625255eb8290f2d7e59cec",
        "zd_lstm.h": "e45bd7f9161c0b3a778f34bc2516a37957147921e1dd2e95588e80db6f000afd",
        "zd_lstm_rows.h": "765ffb27ba613bc800fa2a79aea8db8dd9914c260ecce19485b65f55d257d8c5",
        "zd_network.h": "2690ce0effae61822c7a2b5d38f4e2c5e37c70e1259abc1f20453e0ddbd5514a",
        "zd_runtime.c": "cacb293af4eb2b335230c044174db2bbfdd216fa017f8536eb0be77b5ea4aa19",
        "zd_runtime.h": "31de9f6511774e3cf4ae8c2e15a341b59a8b710d02256d31dbd1eff8f2cf7cb6",
        "zd_signals.h": "c7e69bb0ff4a030fe2729058792970ba58d5bf2454b82550a501f66d8aa74c01",
        "zd_tanh_table.h": "a6b6712c158bcdcc34fe9a9b4c4fda3502f3a1bee22b123f61a7b0d7e7f68e72",
    },
)
"""Runtime format, and the hash of each file of this version; written by `make golden`."""
RELEASED: tuple[tuple[int, Mapping[str, str]], ...] = ()
"""The same of every version that was ever released."""
_INCLUDED = re.compile(r'#[ \t]*include[ \t]*"(zd_\w+\.h)"')
ALWAYS = {"zd_runtime.h", "zd_runtime.c"}


def hash_runtime(texts: Mapping[str, str]) -> dict[str, str]:
    """Return the hash of each file of a runtime, by name.

    Args:
        texts: file name -> content; files that are not the runtime's are left out.
    """
    return {
        name: hashlib.sha256(text.encode()).hexdigest()
        for name, text in sorted(texts.items())
        if name.startswith("zd_")
    }


def is_known(texts: Mapping[str, str]) -> bool:
    """Return whether these are files of one runtime that was compared with the reference.

    They need not be all of them, but whatever one of the texts includes has to be among them.

    Args:
        texts: file name -> content, of the runtime, and of a model's C if that is given too.
    """
    found = hash_runtime(texts)
    included = {name for text in texts.values() for name in _INCLUDED.findall(text)}
    if not ALWAYS | included <= found.keys():
        return False
    return any(found.items() <= files.items() for _, files in (CURRENT, *RELEASED))

"""Number format and threads: chosen by what the machine has, never by timing."""

import os

import torch


def resolve_precision(wanted: str) -> str:
    """``auto`` → ``bf16`` where the CPU has bf16 arithmetic (AVX-512 or AMX), else ``fp32``; others unchanged."""
    if wanted != "auto":
        return wanted
    has_bf16 = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return "bf16" if has_bf16 else "fp32"


def available_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

# SPDX-License-Identifier: Apache-2.0
"""The machine that a step runs on: its refusals, its GPUs, and the cache of machine code.

``resource_errors`` explains refusals (disk, memory, open files) and ``libraries`` names a library that does not load;
``crash_report`` describes a failure of the program itself, and ``output`` keeps a step running when its output has no
reader; ``changed_files`` notices files that changed after the step that wrote them; ``gpu`` reserves one GPU for a job;
``onnx_network`` opens networks on the CPU; ``threads`` are a job's own; ``kernel_cache`` is where numba stores machine
code.
"""

# SPDX-License-Identifier: Apache-2.0
"""The machine that a step runs on, and what it has to be asked for.

``refusals`` says in a sentence what it denies (disk, memory, open files) and ``libraries`` which library does not load;
``fault`` says where the program itself failed, and ``output`` keeps a step going whose output nobody reads;
``gpu`` takes one GPU that no other job holds; ``kernel_cache`` is where numba keeps machine code.
"""

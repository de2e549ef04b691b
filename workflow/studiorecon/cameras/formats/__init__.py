# SPDX-License-Identifier: Apache-2.0
"""One reader per calibration format; each turns its files into ``RawCamera``s in the file's own world and unit."""

"""Tests that cross packages, and the kit of all tests; the others stand beside their packages."""

import sys

# Tests beside a package are below old names of packages, such as `services`, which must not be ours here.
sys.meta_path[:] = [finder for finder in sys.meta_path if not hasattr(finder, "finds_renamed_modules")]

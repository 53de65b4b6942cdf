"""Tests that cross packages, and the kit of all tests; the others stand beside their packages."""

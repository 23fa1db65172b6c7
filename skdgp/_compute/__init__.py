"""Numerics that know neither flights nor models: linear algebra, threads, processes, files."""

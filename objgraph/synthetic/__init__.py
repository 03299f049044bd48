"""Rooms, furniture and streets that are generated: what the sample and the benchmark are made of."""

"""Distillation: a student learns what a teacher would do where the student is (DAgger: Ross et al., 2011)."""

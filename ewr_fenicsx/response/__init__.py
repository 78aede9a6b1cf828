"""Periodic solutions over a range of frequencies: branches followed round folds, shared between ranks, kept on disk."""

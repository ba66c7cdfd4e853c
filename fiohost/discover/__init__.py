"""Name what a declared model lacks: floor, evidence, screening, choice, and the honest answers when nothing fits.

Reads records and models only. Held-out records report and are never used to fit or to choose.
"""

"""The experiments of the two lab texts: one module each, which measures, computes and answers; nothing here prints."""

"""Data checks: is the raw data sound, what does a command mean, what can the logs show?"""

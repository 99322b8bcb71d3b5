"""J and K over several campaigns, and over several spacecraft.

What enters: summaries of fits (`inference.likelihood_summary`), without their telemetry. What
leaves: whether J and K stayed, wandered or jumped, and when (`history`); what sister spacecraft
have in common, and each of them known better by it (`fleet`).
"""

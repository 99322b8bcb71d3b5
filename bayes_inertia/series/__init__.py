"""J and K over several campaigns: from summaries of fits, without their telemetry."""

"""Contract of a servo driver, the registry of brands, and the session under the watchdog."""

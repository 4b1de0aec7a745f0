"""What several tiers of the tests share."""

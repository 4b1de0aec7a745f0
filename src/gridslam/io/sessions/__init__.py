"""What a run or a localization leaves to go on from."""

"""Scan-to-scan tracking: the motion between key scans."""

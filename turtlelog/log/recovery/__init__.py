"""Unfinished or damaged MCAP file, anybody's -> complete file."""

from turtlelog.log.recovery.recover import RecoveryReport, recover_recording

__all__ = ["RecoveryReport", "recover_recording"]

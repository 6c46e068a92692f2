"""What knows no physics: names, settings, files, memory, threads, compiled code."""

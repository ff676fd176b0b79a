"""What a run left: frames, series, fields, and the readers and writers of their files."""

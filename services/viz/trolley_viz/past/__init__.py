"""The past of robots: what was known of them moment by moment, and who looks at which moment."""

"""Who may talk: certificates of the household's hosts, and what each role may do on the wire."""

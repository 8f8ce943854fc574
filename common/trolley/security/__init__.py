"""Who may talk: certificates of the family's hosts, and what each role may do on the wire."""

"""The tour service: saved poses, tours, trips and their history."""

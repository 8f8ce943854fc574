"""The tabs of a page, and what is around them."""

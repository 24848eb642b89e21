"""A page in the browser that looks on at flights: built on viser, which is imported when a page is opened."""

"""Message types, md5 sums and codecs. Pure."""

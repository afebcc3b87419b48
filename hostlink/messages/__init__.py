"""What a payload means: types, md5 sums and the codec; pure."""

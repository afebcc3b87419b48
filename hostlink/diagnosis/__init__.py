"""What is wrong with a link, by what came over its wire: evidence, rules, words. Pure."""

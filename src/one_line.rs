//! Words of others, in messages of one line.

/// So many characters of them are enough.
const MOST: usize = 120;

/// What a file, a decoder or the system says, so that it can stand in one line of a message: no control characters,
/// and not too long.
pub(crate) fn one_line(text: &str) -> String {
    let mut line = String::new();
    for (at, c) in text.chars().enumerate() {
        if at == MOST {
            line.push('…');
            break;
        }
        if c.is_control() {
            line.extend(c.escape_default());
        } else {
            line.push(c);
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_break_a_line_is_escaped_and_what_is_long_is_cut() {
        assert_eq!(one_line("w34633854, Straße 5"), "w34633854, Straße 5");
        assert_eq!(one_line("a\nb\u{7}\t"), "a\\nb\\u{7}\\t");
        let long = one_line(&"ä".repeat(500));
        assert_eq!(long.chars().count(), MOST + 1);
        assert!(long.ends_with("ä…"));
    }
}

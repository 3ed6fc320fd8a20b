//! Tables in Markdown, and the places of a document that hold them.

use std::fmt;

/// A table: the first column to the left, the others to the right.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    pub fn new<const N: usize>(head: [&str; N]) -> Self {
        Self { head: head.map(str::to_owned).to_vec(), rows: Vec::new() }
    }

    /// Adds a row; cells that are missing stay empty.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let mut cells: Vec<String> = cells.into_iter().map(|cell| cell.replace('|', "\\|")).collect();
        cells.resize(self.head.len(), String::new());
        self.rows.push(cells);
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = |f: &mut fmt::Formatter<'_>, cells: &[String]| writeln!(f, "| {} |", cells.join(" | "));
        line(f, &self.head)?;
        let rule: Vec<String> = (0..self.head.len()).map(|column| if column == 0 { "---" } else { "---:" }.to_owned()).collect();
        writeln!(f, "|{}|", rule.join("|"))?;
        self.rows.iter().try_for_each(|row| line(f, row))
    }
}

/// A whole number with a space before every third digit: `305 301`.
pub fn grouped(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    if value < 0.0 && digits != "0" { format!("−{text}") } else { text }
}

/// A number with its sign and decimals: `+1.5`, `−0.7`.
pub fn signed(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let zero = text.chars().all(|c| matches!(c, '0' | '.'));
    format!(
        "{}{text}",
        if zero {
            ""
        } else if value < 0.0 {
            "−"
        } else {
            "+"
        }
    )
}

/// Replaces what stands between `<!-- name -->` and `<!-- end -->` in a document; `None` if it has no
/// such place.
pub fn replace(document: &str, name: &str, text: &str) -> Option<String> {
    let (begin, end) = (format!("<!-- {name} -->"), "<!-- end -->");
    let from = document.find(&begin)? + begin.len();
    let to = from + document[from..].find(end)?;
    // A second beginning before the end would belong to another place.
    (!document[from..to].contains("<!-- ")).then(|| format!("{}\n\n{}\n\n{}", &document[..from], text.trim(), &document[to..]))
}

/// What stands between the marks of a place in a document.
pub fn written<'a>(document: &'a str, name: &str) -> Option<&'a str> {
    let begin = format!("<!-- {name} -->");
    let from = document.find(&begin)? + begin.len();
    let to = from + document[from..].find("<!-- end -->")?;
    Some(document[from..to].trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_markdown() {
        let mut table = Table::new(["what", "mm"]);
        table.row(["a|b".to_owned(), "1".to_owned()]);
        table.row(["c".to_owned()]);
        assert_eq!(table.to_string(), "| what | mm |\n|---|---:|\n| a\\|b | 1 |\n| c |  |\n");
    }

    #[test]
    fn numbers_as_they_are_read() {
        assert_eq!([305_301.4, 999.0, -1_234.6, -0.2].map(grouped), ["305 301", "999", "−1 235", "0"]);
        assert_eq!(signed(1.449, 1), "+1.4");
        assert_eq!(signed(-0.68, 2), "−0.68");
        assert_eq!(signed(-0.001, 2), "0.00");
    }

    #[test]
    fn only_the_part_between_the_marks_is_replaced() {
        let document = "a\n<!-- table 1 -->\nold\n<!-- end -->\nb\n<!-- table 2 -->\nkept\n<!-- end -->\n";
        let new = replace(document, "table 1", "new\n").unwrap();
        assert_eq!(new, "a\n<!-- table 1 -->\n\nnew\n\n<!-- end -->\nb\n<!-- table 2 -->\nkept\n<!-- end -->\n");
        assert_eq!(replace(&new, "table 1", "new").as_deref(), Some(new.as_str()));
        assert_eq!(written(&new, "table 1"), Some("new"));
        assert_eq!(written(&new, "table 2"), Some("kept"));
        assert_eq!(replace(document, "table 3", "new"), None);
        assert_eq!(replace("<!-- table 1 --> <!-- table 2 --> <!-- end -->", "table 1", "new"), None);
    }
}

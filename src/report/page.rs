//! Turns blocks of content into the text of an HTML page.

use std::fmt::Write as _;

use data_encoding::BASE64;

/// A picture with its caption.
#[derive(Clone, Debug)]
pub struct Figure {
    /// The picture as the bytes of a PNG file.
    pub png: Vec<u8>,
    /// What it shows.
    pub caption: String,
}

/// A piece of a page.
#[derive(Clone, Debug)]
pub enum Block {
    /// Opens a section.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// Pictures side by side.
    Figures(Vec<Figure>),
    /// A table: the head, then the rows.
    Table(Vec<String>, Vec<Vec<String>>),
    /// A drawing as SVG, with its caption; it is shown as it is, so that it must be of this program.
    Chart(String, String),
    /// Text in a fixed-width font, line breaks kept.
    Listing(String),
}

/// A page: its title and its blocks in order.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// The title, shown on top and in the window's frame.
    pub title: String,
    /// The content.
    pub blocks: Vec<Block>,
}

const STYLE: &str = "
:root { color-scheme: light dark; --ink: #1c1e21; --paper: #fcfcfa; --line: #d6d6d0; --soft: #66686c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e6e2; --paper: #16181a; --line: #3a3d40; --soft: #9a9da1; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 76rem;
  margin: 2rem auto; padding: 0 1.5rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.2rem; margin-top: 2.4rem; border-bottom: 1px solid var(--line); }
.figures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 20rem), 1fr)); gap: 0.8rem;
  margin: 1rem 0; }
figure { margin: 0; max-width: 25rem; }
figure img { width: 100%; display: block; image-rendering: auto; }
figcaption, .caption { color: var(--soft); font-size: 0.85rem; margin-top: 0.3rem; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
h1, h2, p, figcaption { overflow-wrap: anywhere; }
th, td { white-space: nowrap; text-align: right; padding: 0.25rem 0.8rem; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
svg { max-width: 100%; height: auto; color: var(--ink); }
pre { white-space: pre-wrap; overflow-wrap: anywhere; padding: 0.8rem; border: 1px solid var(--line);
  font-size: 0.8rem; }
@media (max-width: 40rem) { svg { min-width: 36rem; max-width: none; } .chart { overflow-x: auto; } }
@media print { h2 { break-after: avoid; } figure, svg, tr { break-inside: avoid; } .wide { overflow: visible; }
  .figures { grid-template-columns: repeat(3, 1fr); } }
";

impl Page {
    /// Writes the page as HTML.
    ///
    /// # Panics
    /// Never: writing to a string cannot fail.
    pub fn to_html(&self) -> String {
        let title = escape(&self.title);
        let mut html = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
        );
        for block in &self.blocks {
            block.write(&mut html).expect("writing to a string cannot fail");
        }
        html.push_str("</body>\n</html>\n");
        html
    }
}

impl Block {
    fn write(&self, html: &mut String) -> std::fmt::Result {
        match self {
            Self::Heading(text) => writeln!(html, "<h2>{}</h2>", escape(text)),
            Self::Text(text) => writeln!(html, "<p>{}</p>", escape(text)),
            Self::Listing(text) => writeln!(html, "<pre>{}</pre>", escape(text)),
            Self::Chart(svg, caption) => {
                writeln!(
                    html,
                    "<div class=\"chart\">{svg}</div>\n<div class=\"caption\">{}</div>",
                    escape(caption)
                )
            }
            Self::Figures(figures) => {
                html.push_str("<div class=\"figures\">\n");
                for figure in figures {
                    let data = BASE64.encode(&figure.png);
                    let caption = escape(&figure.caption);
                    writeln!(
                        html,
                        "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\">\
                         <figcaption>{caption}</figcaption></figure>"
                    )?;
                }
                html.push_str("</div>\n");
                Ok(())
            }
            Self::Table(head, rows) => {
                // A table that is wider than a phone is moved within its frame.
                html.push_str("<div class=\"wide\"><table>\n");
                write_row(html, "th", head)?;
                for row in rows {
                    write_row(html, "td", row)?;
                }
                html.push_str("</table></div>\n");
                Ok(())
            }
        }
    }
}

fn write_row(html: &mut String, tag: &str, cells: &[String]) -> std::fmt::Result {
    html.push_str("<tr>");
    for cell in cells {
        write!(html, "<{tag}>{}</{tag}>", escape(cell))?;
    }
    html.push_str("</tr>\n");
    Ok(())
}

/// Replaces the characters that HTML gives a meaning.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shows_text_as_text_and_loads_nothing() {
        let page = Page {
            title: "a < b".to_owned(),
            blocks: vec![
                Block::Text("<script>".to_owned()),
                Block::Figures(vec![Figure { png: vec![1, 2, 3], caption: "\"x\"".to_owned() }]),
            ],
        };
        let html = page.to_html();
        assert!(html.contains("a &lt; b") && html.contains("&lt;script&gt;") && !html.contains("<script>"));
        assert!(html.contains("base64,AQID") && !html.contains("http"));
    }
    #[test]
    fn a_wide_table_moves_within_its_frame() {
        let table = Block::Table(vec!["method".to_owned()], vec![vec!["net".to_owned()]]);
        let html = Page { title: String::new(), blocks: vec![table] }.to_html();
        assert!(html.contains("<div class=\"wide\"><table>") && html.contains(".wide { overflow-x: auto;"));
        assert!(html.contains("</table></div>"));
    }
}

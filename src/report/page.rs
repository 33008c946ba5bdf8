//! Turns blocks of content into the text of an HTML page.

use std::fmt::Write as _;

use data_encoding::BASE64;
use sha2::{Digest as _, Sha256};

use super::viewer::Viewer;

/// A picture with its caption.
#[derive(Clone, Debug)]
pub struct Figure {
    /// The picture as the bytes of a PNG or JPEG file.
    pub picture: Vec<u8>,
    /// What it shows.
    pub caption: String,
}

/// A piece of a page.
#[derive(Clone, Debug)]
pub enum Block {
    /// Opens a section.
    Heading(String),
    /// Opens a part of a section.
    Subheading(String),
    /// A paragraph.
    Text(String),
    /// Pictures side by side.
    Figures(Vec<Figure>),
    /// Small pictures side by side, as many as a line takes.
    Strip(Vec<Figure>),
    /// Pictures under one divider, to look at closely.
    Viewer(Box<Viewer>),
    /// A table: the head, then the rows.
    Table(Vec<String>, Vec<Vec<String>>),
    /// A drawing as SVG, with its caption; it is shown as it is, so that it must be of this program.
    Chart(String, String),
    /// Drawings side by side where there is room, as in [`Self::Chart`].
    Charts(Vec<(String, String)>),
    /// Text in a fixed-width font, line breaks kept.
    Listing(String),
    /// What is shown on demand, and on paper: a line that says what it is, and its content.
    Fold(String, Vec<Self>),
}

/// A page: its title and its blocks in order.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// The title, shown on top and in the window's frame.
    pub title: String,
    /// The content.
    pub blocks: Vec<Block>,
}

const STYLE: &str = include_str!("page/style.css");

/// What the page does, from the ground up.
const SCRIPTS: [&str; 6] = [
    include_str!("page/develop.js"),
    include_str!("page/picture.js"),
    include_str!("page/gl.js"),
    include_str!("page/canvas.js"),
    include_str!("page/viewer.js"),
    include_str!("page/page.js"),
];

/// The controls of a viewer, which the script copies into each.
const VIEWER_CONTROLS: &str = include_str!("page/viewer.html");

/// The head of the page's body; it lacks the title and the version.
const TOOLS: &str = include_str!("page/tools.html");

impl Page {
    /// Writes the page as HTML.
    ///
    /// The page says that nothing is loaded from anywhere and that no script and style but its own counts, by their hashes
    /// (Content Security Policy), so that text of a file could do nothing even if it became markup.
    ///
    /// # Panics
    /// Never: writing to a string cannot fail.
    pub fn to_html(&self) -> String {
        let title = escape(&self.title);
        let script = script();
        let [of_script, of_style] = [&script, STYLE].map(|text| BASE64.encode(&Sha256::digest(text)));
        let mut html = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; \
             style-src 'sha256-{of_style}'; script-src 'sha256-{of_script}'; base-uri 'none'; form-action 'none'\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<header class=\"page-head\">\n\
             <div><h1>{title}</h1>\n<p class=\"page-made\">Made by udc {}. The page loads nothing from \
             anywhere.</p></div>\n{TOOLS}</header>\n",
            env!("CARGO_PKG_VERSION")
        );
        self.write_contents(&mut html).expect("writing to a string cannot fail");
        html.push_str("<main>\n");
        for (index, block) in self.blocks.iter().enumerate() {
            block.write(&mut html, index).expect("writing to a string cannot fail");
        }
        html.push_str("</main>\n");
        if self.blocks.iter().any(|block| matches!(block, Block::Viewer(_))) {
            html.push_str(VIEWER_CONTROLS);
        }
        html.push_str("<script>");
        html.push_str(&script);
        html.push_str("</script>\n</body>\n</html>\n");
        html
    }

    /// Links to the sections, where there are several.
    fn write_contents(&self, html: &mut String) -> std::fmt::Result {
        let headings: Vec<_> = (self.blocks.iter().enumerate())
            .filter_map(|(index, block)| match block {
                Block::Heading(text) => Some((index, text)),
                _ => None,
            })
            .collect();
        if headings.len() < 2 {
            return Ok(());
        }
        html.push_str("<nav class=\"page-contents\" aria-label=\"Contents\"><ul>\n");
        for (index, text) in headings {
            writeln!(html, "<li><a href=\"#section-{index}\">{}</a></li>", escape(text))?;
        }
        html.push_str("</ul></nav>\n");
        Ok(())
    }
}

/// All of the page's script, in a scope of its own.
fn script() -> String {
    format!("(() => {{\n\"use strict\";\n{}}})();\n", SCRIPTS.concat())
}

impl Block {
    fn write(&self, html: &mut String, index: usize) -> std::fmt::Result {
        match self {
            Self::Heading(text) => writeln!(html, "<h2 id=\"section-{index}\">{}</h2>", escape(text)),
            Self::Subheading(text) => writeln!(html, "<h3>{}</h3>", escape(text)),
            Self::Text(text) => writeln!(html, "<p>{}</p>", escape(text)),
            Self::Listing(text) => writeln!(html, "<pre>{}</pre>", escape(text)),
            Self::Chart(svg, caption) => write_chart(html, svg, caption),
            Self::Charts(charts) => {
                html.push_str("<div class=\"charts\">\n");
                for (svg, caption) in charts {
                    html.push_str("<div>");
                    write_chart(html, svg, caption)?;
                    html.push_str("</div>\n");
                }
                html.push_str("</div>\n");
                Ok(())
            }
            Self::Figures(figures) => write_figures(html, "figures", figures),
            Self::Strip(figures) => write_figures(html, "figures strip", figures),
            Self::Viewer(viewer) => viewer.write(html, index),
            Self::Table(head, rows) => write_table(html, head, rows),
            Self::Fold(summary, blocks) => {
                open_fold(html, summary)?;
                blocks.iter().try_for_each(|block| block.write(html, index))?;
                html.push_str("</details>\n");
                Ok(())
            }
        }
    }
}

/// Opens what a script folds, so that all is seen without scripts.
pub(super) fn open_fold(html: &mut String, summary: &str) -> std::fmt::Result {
    writeln!(html, "<details class=\"fold\" open><summary>{}</summary>", escape(summary))
}

fn write_chart(html: &mut String, svg: &str, caption: &str) -> std::fmt::Result {
    let caption = escape(caption);
    // A drawing that is wider than a phone is moved within its frame, by keys as well.
    writeln!(
        html,
        "<div class=\"chart\" tabindex=\"0\" role=\"group\" aria-label=\"{caption}\">{svg}</div>\n\
         <div class=\"caption\">{caption}</div>"
    )
}

fn write_figures(html: &mut String, class: &str, figures: &[Figure]) -> std::fmt::Result {
    writeln!(html, "<div class=\"{class}\">")?;
    for figure in figures {
        let caption = escape(&figure.caption);
        html.push_str("<figure>");
        write_image(html, &format!("alt=\"{caption}\""), &figure.picture)?;
        writeln!(html, "<figcaption>{caption}</figcaption></figure>")?;
    }
    html.push_str("</div>\n");
    Ok(())
}

/// Writes a picture with these attributes, decoded when it comes into view.
pub(super) fn write_image(html: &mut String, attributes: &str, picture: &[u8]) -> std::fmt::Result {
    let kind = if picture.starts_with(&[0xff, 0xd8]) { "jpeg" } else { "png" };
    write!(html, "<img {attributes} decoding=\"async\" src=\"data:image/{kind};base64,")?;
    BASE64.encode_append(picture, html);
    html.push_str("\">");
    Ok(())
}

fn write_table(html: &mut String, head: &[String], rows: &[Vec<String>]) -> std::fmt::Result {
    // A table that is wider than a phone is moved within its frame, by keys as well.
    html.push_str("<div class=\"wide\" tabindex=\"0\" role=\"group\" aria-label=\"Table\"><table>\n<thead>");
    write_row(html, "th", head)?;
    html.push_str("</thead>\n<tbody>\n");
    for row in rows {
        write_row(html, "td", row)?;
    }
    html.push_str("</tbody></table></div>\n");
    Ok(())
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

    /// The body without the page's own script and controls.
    fn content(html: &str) -> &str {
        let (_, rest) = html.split_once("<main>").unwrap();
        rest.split_once("</main>").unwrap().0
    }

    #[test]
    fn shows_text_as_text_and_loads_nothing() {
        let page = Page {
            title: "a < b".to_owned(),
            blocks: vec![
                Block::Text("<script>".to_owned()),
                Block::Figures(vec![Figure { picture: vec![1, 2, 3], caption: "\"x\"".to_owned() }]),
            ],
        };
        let html = page.to_html();
        assert!(html.contains("a &lt; b") && html.contains("&lt;script&gt;"));
        assert!(!content(&html).contains("<script") && html.matches("<script").count() == 1);
        assert!(html.contains("base64,AQID") && !html.contains("://"));
    }

    #[test]
    fn only_the_pages_own_script_and_style_count() {
        let html = Page::default().to_html();
        let between = |from: &str, to: &str| {
            let (_, rest) = html.split_once(from).unwrap();
            rest.split_once(to).unwrap().0.to_owned()
        };
        for (tag, end) in [("<script>", "</script>"), ("<style>", "</style>")] {
            let hash = BASE64.encode(&Sha256::digest(between(tag, end)));
            assert!(html.contains(&format!("'sha256-{hash}'")), "{tag}");
        }
        assert!(between("Content-Security-Policy\"", ">").contains("default-src 'none'; img-src data:;"));
        // What would be executed, loaded or styled from an attribute is refused by that policy.
        assert!(!html.contains(" style=") && !html.contains(" onclick="));
    }

    #[test]
    fn a_wide_table_moves_within_its_frame() {
        let table = Block::Table(vec!["method".to_owned()], vec![vec!["net".to_owned()]]);
        let html = Page { title: String::new(), blocks: vec![table] }.to_html();
        assert!(
            html.contains("<div class=\"wide\" tabindex=\"0\"") && html.contains(".wide { overflow-x: auto;")
        );
        assert!(html.contains("<thead><tr><th>method</th></tr>") && html.contains("</table></div>"));
    }

    #[test]
    fn several_sections_have_links() {
        let heading = |text: &str| Block::Heading(text.to_owned());
        let page = |blocks: Vec<Block>| Page { title: String::new(), blocks }.to_html();
        let html = page(vec![heading("one"), Block::Text("text".to_owned()), heading("<two>")]);
        assert!(
            html.contains("<a href=\"#section-2\">&lt;two&gt;</a>") && html.contains("<h2 id=\"section-2\">")
        );
        assert!(!page(vec![heading("one")]).contains("<nav"));
    }
}

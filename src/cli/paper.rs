//! The figures of the paper.
#![allow(dead_code, unused_imports)] // Until the command is there.

mod fig1;
mod fig2;

pub use {fig1::fig1, fig2::fig2};

/// What a figure without training leaves.
pub struct Plain {
    pub drawing: physgrad::report::Drawing,
    pub csv: Vec<u8>,
    /// Markdown.
    pub table: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An SVG that can be read, of a size for the web; numbers in every cell of the CSV; a table.
    fn check(name: &str, header: &str, figure: Plain) {
        let svg = figure.drawing.to_svg();
        roxmltree::Document::parse(&svg).expect("an SVG is XML");
        assert!(!svg.contains("NaN") && svg.len() < 500_000, "{} bytes", svg.len());
        let csv = String::from_utf8(figure.csv).expect("CSV is text");
        assert_eq!(csv.lines().next(), Some(header));
        assert!(csv.lines().count() > 100 && !csv.contains("NaN"));
        assert!(figure.table.lines().count() >= 4);
        if let Some(folder) = std::env::var_os("PHYSGRAD_PAPER").map(std::path::PathBuf::from) {
            std::fs::write(folder.join(format!("{name}.svg")), svg).expect("a folder");
            std::fs::write(folder.join(format!("{name}.png")), figure.drawing.to_png()).expect("a folder");
            std::fs::write(folder.join(format!("{name}.csv")), csv).expect("a folder");
            println!("{}", figure.table);
        }
    }

    #[test]
    fn figures_without_training() {
        for quick in [true, false] {
            check("fig1", "theta_1,theta_2,loss,r_1,r_2,m_1,m_2", fig1(quick).expect("figure 1"));
            check("fig2", "method,iteration,theta_1,theta_2,loss", fig2(quick).expect("figure 2"));
        }
    }
}

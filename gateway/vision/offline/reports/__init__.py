"""Self-contained HTML pages: charts drawn as SVG, pictures embedded, nothing fetched from anywhere."""

// Maps that follow the charts, and the beginning of everything.

// Marks on the maps the place where a flight was at the cursor.
class Track {
  constructor(map, { link, time, east, north }) {
    Object.assign(this, { link: links.get(link), time, east, north });
    this.marks = [...map.querySelectorAll("svg[data-map]")].map((svg) => {
      const mark = document.createElementNS(map.querySelector("svg").namespaceURI, "circle");
      mark.setAttribute("class", "place");
      mark.setAttribute("r", "4");
      mark.setAttribute("visibility", "hidden");
      svg.append(mark);
      return { mark, scale: svg.dataset.map.split(" ").map(Number) };
    });
    this.link.tracks.push(this);
  }

  read() {
    const { time } = this, { cursor } = this.link;
    const known = cursor !== null && cursor >= time[0] && cursor <= time[time.length - 1];
    const k = known ? Math.min(Math.max(index(time, cursor), 1), time.length - 1) : 1;
    const part = (cursor - time[k - 1]) / (time[k] - time[k - 1]);
    const place = (values) => values[k - 1] + part * (values[k] - values[k - 1]);
    for (const { mark, scale: [a, b, c, d] } of this.marks) {
      mark.setAttribute("visibility", known ? "visible" : "hidden");
      mark.setAttribute("cx", known ? a + b * place(this.east) : 0);
      mark.setAttribute("cy", known ? c + d * place(this.north) : 0);
    }
  }
}

// ---- begin --------------------------------------------------------------------------------------

async function begin() {
  if (!("DecompressionStream" in window)) return; // the pictures remain
  for (const figure of document.querySelectorAll("figure.chart")) {
    const holder = figure.querySelector('script[type="application/json"]');
    const spec = JSON.parse(holder.textContent);
    const chart = new Chart(figure, spec, await unpack(spec));
    chart.draw();
  }
  for (const map of document.querySelectorAll(".map"))
    for (const track of JSON.parse(map.querySelector('script[type="application/json"]').textContent))
      if (links.has(track.link) && track.time.length > 1) new Track(map, track);
  document.documentElement.dataset.charts = "ready";
}

begin();

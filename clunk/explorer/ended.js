// Say that nobody answers any more.
if (!document.getElementById("ended")) {
  const banner = document.createElement("div");
  banner.id = "ended";
  banner.textContent = "The explorer has ended: this page no longer answers. Start clunk explore again and open the address that it prints.";
  document.body.append(banner);
}

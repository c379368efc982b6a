"""A page that is laid out as the supplement of the paper's authors."""

#: With made-up sentences.
PAGE = f"""<!DOCTYPE html><nav><ul><li><a href="#sec-force-prompts">Force prompts</a></li></ul></nav>
<h2 id="sec-force-variants">A</h2><h4>Variant 1</h4><ul><li>More of it</li></ul>
<h2 id="sec-prompts">C</h2>
<h2 class="section-heading" id="sec-force-prompts">Force</h2>
<h3>General</h3><ul><li><code>Make it smaller
  than 1.</code></li></ul>
<h3>Layers &amp; more</h3><ul>{"<li>Again.</li>" * 18}
<li><code>Add a `nn.Tanh` between &minus;1 and 1.</code></li><li></li></ul>
<h2 id="sec-grating-prompts">Grating</h2><ul><li><code>Widen `conv2` for $5.</code></li>{"<li>Again.</li>" * 16}</ul>
<h2 id="sec-system-prompts">D</h2>
<h3 id="sec-force-sys">Force</h3><p>As follows.</p>
<div class="listing-block">Change ImageRegressionCNN: {{instruction_prompt}}

Code:
```python
{{base_net_code}}
```
</div>
<h3 id="sec-grating-sys">Grating</h3>
<div class="wide listing-block">Change it for $5 &lt; $6, {{instruction_prompt}}: {{base_net_code}}</div>
<h2 id="sec-hardness">E</h2><ul><li>Not an instruction</li></ul>
"""
